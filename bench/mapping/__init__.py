"""Map quality of calm-edge with and without each part of section VI, and of the baselines.

All variants use the same depth.
"""
