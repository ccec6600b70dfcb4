"""Alignments the paper compares with (VII), on the same sub-maps."""
