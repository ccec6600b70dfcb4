"""Processor time and memory of calm-edge: by stage, over a long drive, on a loaded machine."""
