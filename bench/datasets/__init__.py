"""The paper's datasets in their published folder layouts, converted to sequence folders.

A loader returns a Drive; writing it makes links to the pictures and text files beside them, on
which `record` and `eval` run. Nothing of a dataset is copied or shipped.
"""
