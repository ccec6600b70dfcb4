"""Recordings that no metre can come of, or that mislead: what `record` makes of them."""
