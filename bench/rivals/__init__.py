"""What a user would pick instead, run on the same pictures: evaluation only, nothing ships.

Each is a process of its own in a Python environment of its own under build/rivals, made when it
is first asked for; where that fails the rival is skipped and the reason said.
"""
