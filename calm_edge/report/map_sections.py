"""Pictures of the map for the report: from above, and along the street."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence

import cv2
import numpy as np

from calm_edge.report import chart, map_image, page
from calm_edge.types import Bytes, Float, Float32
from device.frame import jpeg

# Larger clouds are thinned evenly to this number, which suffices for the images.
MAX_DRAWN_POINTS = 3_000_000


def photo(image: Bytes, *, empty: bool = False) -> str:
    """A picture (H, W, 3) RGB as data address. empty: what is PAPER is transparent."""
    if not empty:
        data = jpeg(np.ascontiguousarray(image[..., ::-1]))
        return "data:image/jpeg;base64," + base64.b64encode(data).decode()
    drawn = (image != map_image.PAPER).any(-1)
    bgra = np.dstack([image[..., ::-1], np.where(drawn, 255, 0).astype(np.uint8)])
    webp = cv2.imencode(".webp", bgra, [cv2.IMWRITE_WEBP_QUALITY, 82])[1]
    return "data:image/webp;base64," + base64.b64encode(webp.tobytes()).decode()


def _bar_length(span: float) -> float:
    """Length of a scale bar: 1, 2 or 5 times a power of ten, at most a fifth of the span."""
    power = 10.0 ** np.floor(np.log10(max(span / 5, 1e-12)))
    return float(max(power * k for k in (1, 2, 5) if power * k <= span / 5 * 1.0001))


def _map_from_above(view: map_image.TopDown, paths: Sequence[Float], unit: str) -> str:
    height, width = view.image.shape[:2]
    bar = _bar_length(width * view.pixel)
    share = 100 * bar / (width * view.pixel)
    stroke = f'fill="none" stroke="{chart.ESTIMATE}" stroke-linejoin="round"'
    lines = ""
    for path in paths:
        line = " ".join(f"{u:.1f},{v:.1f}" for u, v in view.to_pixels(path))
        lines += f'<polyline points="{line}" {stroke} stroke-width="3" stroke-opacity=".85"/>'
    # the length beside the bar is the page's text, which does not shrink with the picture
    return (
        f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="map from above">'
        f'<image width="{width}" height="{height}" href="{photo(view.image, empty=True)}"/>'
        f"{lines}</svg>"
        f'<div class="scale"><i style="width:{share:.2f}%"></i>{bar:g} {html.escape(unit)}</div>'
    )


def sections(
    points_w: Float32 | None, color: Bytes | None, R: Float, paths: Sequence[Float], unit: str
) -> list[str]:
    """Both sections; none without points. The street is shown along the longest path.

    points_w: (P, 3), color: (P, 3) RGB. R: (3, 3) world -> level frame. paths: (N, 3) of each
    drive, level.
    """
    if points_w is None or color is None:
        return []
    finite = np.flatnonzero(np.isfinite(points_w).all(1))
    if len(finite) == 0:
        return []
    kept = finite[:: max(len(finite) // MAX_DRAWN_POINTS, 1)]
    points, paint = np.asarray(points_w[kept], np.float64) @ R.T, color[kept]
    view = map_image.top_down(points, paint, np.concatenate(paths))
    above = _map_from_above(view, paths, unit)
    views = map_image.best_chases(points, paint, max(paths, key=len))
    photos = "".join(
        f'<img alt="map along the street" src="{photo(v, empty=True)}">' for v in views
    )
    return [
        page.section("The map from above", f"{len(finite):,} points in their own colours.", above),
        page.section("The map along the street", "Seen from behind and above the car.", photos),
    ]
