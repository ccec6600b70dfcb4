"""Baselines of the paper (section VII): other methods that align the same sub-maps."""
