"""Time and memory: of each stage, over a long drive, and under load."""
