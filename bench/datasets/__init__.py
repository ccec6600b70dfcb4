"""The paper's datasets in their published folder layouts, as the sequence folders we replay.

A loader yields a Drive; writing one makes links to the pictures and text files beside them, so
that `record` and `eval` run on it unchanged. Nothing of a dataset is copied or shipped.
"""
