"""Accuracy of `record` under four conditions on three tracks, and on real clips."""
