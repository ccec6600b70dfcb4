"""Pictures of the demo drive."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np

DRIVE = Path(__file__).parents[3] / "demo" / "drive"


@cache
def picture(index, eye=0):
    """(H, W, 3) BGR of a frame of an eye."""
    return cv2.imread(str(DRIVE / f"cam{eye}" / f"{index:06d}.jpg"))


def similarity(gray, zoom, turn_deg, shift=(0.0, 0.0)):
    """H (3, 3) px about the middle of a picture."""
    height, width = gray.shape
    middle = ((width - 1) / 2, (height - 1) / 2)
    H = np.eye(3)
    H[:2] = cv2.getRotationMatrix2D(middle, turn_deg, zoom)
    H[:2, 2] += shift
    return H


def through(H, uv):
    return cv2.perspectiveTransform(uv[None].astype(np.float64), H)[0]


def seen(gray, H):
    return np.asarray(cv2.warpPerspective(gray, H, gray.shape[::-1], borderMode=cv2.BORDER_REFLECT))
