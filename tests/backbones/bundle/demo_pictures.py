"""Pictures of the demo drive."""

from functools import cache
from pathlib import Path

import cv2

DRIVE = Path(__file__).parents[3] / "demo" / "drive"


@cache
def picture(index, eye=0):
    """(H, W, 3) BGR of a frame of an eye."""
    return cv2.imread(str(DRIVE / f"cam{eye}" / f"{index:06d}.jpg"))
