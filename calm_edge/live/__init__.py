"""The live page: what a recording shows of itself while it runs, in a process of its own."""
