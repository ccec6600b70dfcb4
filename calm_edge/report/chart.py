"""Charts as SVG text, in the colours of the page that they stand in.

Colours are custom properties of `page`, with the light ones as fallback, so a chart follows the
page's dark mode and can also be a file of its own. No ids: any number of charts fit on one page.
"""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np

from calm_edge.types import Float

INK, MUTED, GRID = "var(--ink,#1f2933)", "var(--muted,#6b7785)", "var(--grid,#e3e7eb)"
ESTIMATE, TRUTH = "var(--estimate,#0b6bcb)", "var(--truth,#d9822b)"
ASSISTANT = "var(--assistant,#a03d8f)"
BAD = "var(--bad,#c42318)"

# of a page and of a phone: a chart is drawn in both widths, since text must not shrink with it
WIDTH, NARROW = 960, 400
# margins of the plotting area [px], and the height of one row of the legend above it
LEFT, RIGHT, BOTTOM, LEGEND = 76, 16, 46, 28
# distance between vertical grid lines, about [px]; never fewer than MIN_TICKS_X
TICK_PX, MIN_TICKS_X, TICKS_Y = 108, 4, 5
_FONT = 'font-family="system-ui,sans-serif" font-size="13"'
# mean width of a character at that size
_CHARACTER_PX = 7.0
# seconds between labels of a clock
_CLOCK_STEPS = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400)


def ticks(low: float, high: float, count: int) -> Float:
    """Multiples of 1, 2 or 5 times a power of ten in [low, high], about `count` of them."""
    span = high - low
    power = 10.0 ** np.floor(np.log10(span / count))
    step = min((k * power for k in (1, 2, 5, 10)), key=lambda s: abs(span / s - count))
    first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
    return np.asarray(step * np.arange(first, last + 1))


def limits(*values: Float, margin: float = 0.04) -> tuple[float, float]:
    """Range of the finite values with a margin on both sides; of length 1 if all are equal."""
    joined = np.concatenate([np.ravel(v) for v in values])
    joined = joined[np.isfinite(joined)]
    if not len(joined):
        return 0.0, 1.0
    low, high = float(joined.min()), float(joined.max())
    extra = margin * (high - low) if high > low else 0.5
    return low - extra, high + extra


class Chart:
    """One plotting area with axes, grid and legend; add curves, then take `svg`.

    x, y: (low, high) of the axes. labels: of the x and the y axis. height: of the whole with one
    row of legend, in px of `width`. equal: one unit is as long on both axes; the range that is too
    short is widened. clock: x is in seconds, labelled m:ss.
    """

    def __init__(
        self,
        x: tuple[float, float],
        y: tuple[float, float],
        labels: tuple[str, str],
        height: int,
        *,
        width: int = WIDTH,
        equal: bool = False,
        clock: bool = False,
    ) -> None:
        self.width, self._height, self._clock = width, height, clock
        self._size = np.array([width - LEFT - RIGHT, height - BOTTOM - LEGEND], np.float64)
        low, high = np.array([x, y], np.float64).T
        if equal:
            span = np.maximum(high - low, 1e-9)
            wanted = self._size * (span / self._size).max()
            low, high = (low + high - wanted) / 2, (low + high + wanted) / 2
        self._low, self._high, self._labels = low, high, labels
        self._marks: list[str] = []
        self._legend: list[tuple[str, str]] = []

    @property
    def height(self) -> float:
        """Height of the whole [px]: the legend may have more than one row."""
        return self._height + self._raised

    def line(
        self,
        x: Float,
        y: Float,
        color: str,
        name: str = "",
        *,
        width: float = 1.6,
        dash: str = "",
        opacity: float = 1.0,
        dots: bool = False,
    ) -> None:
        """Draw a curve through x, y (N,), broken where a value is not finite.

        name: in the legend. dash: SVG's stroke-dasharray. dots: mark each point.
        """
        style = f'stroke="{color}" stroke-width="{width:g}" stroke-opacity="{opacity:g}"'
        style += f' stroke-dasharray="{dash}"' if dash else ""
        p = self._pixels(np.asarray(x, np.float64), np.asarray(y, np.float64))
        finite = np.isfinite(p[:, 0]) & np.isfinite(p[:, 1])
        for run in np.split(np.arange(len(p)), np.flatnonzero(np.diff(finite)) + 1):
            if finite[run[:1]].any():
                points = _points(p[run])
                self._marks.append(
                    f'<polyline points="{points}" fill="none" stroke-linejoin="round" {style}/>'
                )
        if dots:
            for u, v in p[finite]:
                self._marks.append(f'<circle cx="{u:.1f}" cy="{v:.1f}" r="3.2" fill="{color}"/>')
        self._note(name, f'<path d="M0 0H22" {style}/>')

    def points(self, x: Float, y: Float, color: str, name: str = "") -> None:
        """Mark the points x, y (N,) that are finite with small rings, without a line."""
        p = self._pixels(np.asarray(x, np.float64), np.asarray(y, np.float64))
        style = f'r="2.6" fill="none" stroke="{color}" stroke-width="1.3"'
        for u, v in p[np.isfinite(p).all(1)]:
            self._marks.append(f'<circle cx="{u:.1f}" cy="{v:.1f}" {style}/>')
        self._note(name, f'<circle cx="11" {style}/>')

    def band(self, x: Float, low: Float, high: Float, color: str, opacity: float) -> None:
        """Fill the area between two curves; x, low, high: (N,), finite."""
        edge = np.concatenate([self._pixels(x, high), self._pixels(x, low)[::-1]])
        self._marks.append(
            f'<polygon points="{_points(edge)}" fill="{color}" fill-opacity="{opacity:g}"/>'
        )

    def level(self, y: float, color: str, name: str = "", *, dash: str = "2 3") -> None:
        """Draw a horizontal line across the area."""
        x = np.array([self._low[0], self._high[0]])
        self.line(x, np.full(2, y), color, name, width=1.2, dash=dash)

    def span(self, start: float, end: float, color: str, name: str = "") -> None:
        """Shade the area between two values of x, at least 2 px wide."""
        (u, _), (end_u, _) = self._pixels(np.array([start, end]), np.zeros(2))
        area = f'height="{self._size[1]:g}" fill="{color}" fill-opacity=".25"'
        self._marks.append(f'<rect x="{u:.1f}" y="0" width="{max(end_u - u, 2):.1f}" {area}/>')
        self._note(name, f'<rect y="-6" width="22" height="12" fill="{color}" fill-opacity=".25"/>')

    def dot(self, x: float, y: float, color: str, name: str = "", *, square: bool = False) -> None:
        """Mark one point with a disc or a square."""
        (u, v) = self._pixels(np.array([x]), np.array([y]))[0]
        shape = '<rect x="{:.1f}" y="{:.1f}" width="9" height="9" fill="{}"/>'
        if not square:
            shape = '<rect x="{:.1f}" y="{:.1f}" width="9" height="9" rx="4.5" fill="{}"/>'
        self._marks.append(shape.format(u - 4.5, v - 4.5, color))
        self._note(name, shape.format(6.5, -4.5, color))

    def svg(self, alt: str) -> str:
        """The chart as an SVG element. alt: what it shows, for those who cannot see it."""
        width, height = self._size
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height:g}"'
            f' role="img" aria-label="{html.escape(alt)}" {_FONT}>{self._legends()}'
            f'<g transform="translate(0 {self._raised:g})">{self._axes()}'
            # an inner svg clips what is outside of the axes
            f'<svg x="{LEFT}" y="{LEGEND}" width="{width:g}" height="{height:g}"'
            f' viewBox="0 0 {width:g} {height:g}">{"".join(self._marks)}</svg></g></svg>'
        )

    def _pixels(self, x: Float, y: Float) -> Float:
        """Pixels (N, 2) in the plotting area."""
        share = (np.stack([x, y], 1) - self._low) / (self._high - self._low)
        return np.asarray((share * [1, -1] + [0, 1]) * self._size)

    def _axes(self) -> str:
        (width, height), parts = self._size, []
        bottom = LEGEND + height
        x_ticks = self._x_ticks()
        y_ticks = ticks(self._low[1], self._high[1], TICKS_Y)
        for value, (u, _) in zip(x_ticks, self._pixels(x_ticks, 0 * x_ticks), strict=True):
            u += LEFT
            parts.append(f'<path d="M{u:.1f} {LEGEND}V{bottom:g}" stroke="{GRID}"/>')
            text = minutes(value) if self._clock else f"{value + 0.0:g}"
            parts.append(_text(u, bottom + 18, text, "middle"))
        for value, (_, v) in zip(y_ticks, self._pixels(0 * y_ticks, y_ticks), strict=True):
            v += LEGEND
            parts.append(f'<path d="M{LEFT} {v:.1f}h{width:g}" stroke="{GRID}"/>')
            parts.append(_text(LEFT - 8, v + 4, f"{value + 0.0:g}", "end"))
        parts.append(
            f'<path d="M{LEFT} {LEGEND}V{bottom:g}h{width:g}" fill="none" stroke="{MUTED}"/>'
        )
        parts.append(_text(LEFT + width / 2, self._height - 8, self._labels[0], "middle"))
        turn = f"translate(16 {LEGEND + height / 2:g}) rotate(-90)"
        label = _text(0, 0, self._labels[1], "middle")
        return "".join(parts) + f'<g transform="{turn}">{label}</g>'

    def _x_ticks(self) -> Float:
        """Where the vertical grid lines are; on whole minutes or round parts of one of a clock."""
        low, high = float(self._low[0]), float(self._high[0])
        count = max(round(self._size[0] / TICK_PX), MIN_TICKS_X)
        if not self._clock or high - low < 2 * count:
            return ticks(low, high, count)
        step = min(_CLOCK_STEPS, key=lambda s: abs((high - low) / s - count))
        return np.asarray(step * np.arange(np.ceil(low / step), np.floor(high / step) + 1))

    def _note(self, name: str, sign: str) -> None:
        if name:
            self._legend.append((name, sign))

    def _rows(self) -> list[list[tuple[float, str, str]]]:
        """Entries (u, name, sign) of the legend in rows that fit the width."""
        rows: list[list[tuple[float, str, str]]] = [[]]
        u = first = float(LEFT if self.width == WIDTH else 12)
        for name, sign in self._legend:
            end = u + 29 + _CHARACTER_PX * len(name)
            if rows[-1] and end > self.width:
                rows.append([])
                u, end = first, first + end - u
            rows[-1].append((u, name, sign))
            u = end + 22
        return rows

    @property
    def _raised(self) -> float:
        return LEGEND * (len(self._rows()) - 1.0)

    def _legends(self) -> str:
        parts = []
        for number, row in enumerate(self._rows()):
            for u, name, sign in row:
                v = LEGEND * number
                parts.append(f'<g transform="translate({u:g} {v + 13:g})">{sign}</g>')
                parts.append(_text(u + 29, v + 17, name, "start", INK))
        return "".join(parts)


def minutes(seconds: float) -> str:
    """A time since the start as m:ss, with an hour h:mm:ss; a part of a second is left out."""
    hours, rest = divmod(int(seconds), 3600)
    text = f"{rest // 60:02d}:{rest % 60:02d}" if hours else f"{rest // 60}:{rest % 60:02d}"
    return f"{hours}:{text}" if hours else text


def stacked(charts: Sequence[Chart], alt: str) -> str:
    """Charts below each other, as one SVG element."""
    parts, top = [], 0.0
    for chart in charts:
        inner = chart.svg(alt).replace("<svg ", f'<svg y="{top:g}" height="{chart.height:g}" ', 1)
        parts.append(inner)
        top += chart.height
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {top:g}" role="img"'
        f' aria-label="{html.escape(alt)}">{"".join(parts)}</svg>'
    )


def _points(p: Float) -> str:
    return " ".join(f"{u:.1f},{v:.1f}" for u, v in p)


def _text(u: float, v: float, text: str, anchor: str, color: str = MUTED) -> str:
    return (
        f'<text x="{u:.1f}" y="{v:.1f}" text-anchor="{anchor}" fill="{color}">'
        f"{html.escape(text)}</text>"
    )
