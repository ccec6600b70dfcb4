"""The linear alignments the paper compares with, on the same sub-maps; for evaluation only."""
