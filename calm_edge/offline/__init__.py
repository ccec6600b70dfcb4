"""Computations of `map`: the sub-maps of a recording, their depth, and the output files."""
