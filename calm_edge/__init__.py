"""calm-edge: calibration-free SLAM with two ordinary cameras."""

__version__ = "0.1.0"
