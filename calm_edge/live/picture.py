"""Pictures of the live page: small enough for a phone."""

from __future__ import annotations

import base64
from typing import Any

import cv2
import numpy as np

from calm_edge.live.wire import Message

WIDTH_PX, QUALITY = 640, 70
# JPEG can be decoded to a half, a quarter or an eighth of its size, in a fraction of the time
_REDUCED = {
    1: cv2.IMREAD_COLOR,
    2: cv2.IMREAD_REDUCED_COLOR_2,
    4: cv2.IMREAD_REDUCED_COLOR_4,
    8: cv2.IMREAD_REDUCED_COLOR_8,
}


def content(message: Message) -> dict[str, Any] | None:
    """Content of a picture's message for the page; None if it cannot be decoded.

    With the picture as `src`, at most WIDTH_PX wide, and the `width` and `height` of the original,
    in whose pixels `moves` and `points` are.
    """
    data = np.frombuffer(message.data, np.uint8)
    first = cv2.imdecode(data, cv2.IMREAD_REDUCED_GRAYSCALE_8) if data.size else None
    if first is None:
        return None
    reduction = max([r for r in _REDUCED if 8 * first.shape[1] >= r * WIDTH_PX], default=1)
    image = cv2.imdecode(data, _REDUCED[reduction])
    if image is None:
        return None
    height, width = image.shape[0] * reduction, image.shape[1] * reduction
    scale = min(1.0, WIDTH_PX / image.shape[1])
    if scale < 1:
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    small = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
    text = base64.b64encode(small.tobytes()).decode()
    return {
        **message.content,
        "width": width,
        "height": height,
        "src": f"data:image/jpeg;base64,{text}",
    }
