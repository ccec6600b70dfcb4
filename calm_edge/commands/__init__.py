"""One module per command: `configure(parser)` and `run(arguments) -> exit code`.

Heavy modules are imported inside these functions.
"""
