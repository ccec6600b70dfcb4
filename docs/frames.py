"""Draw frames.svg, the frames of ODOMETRY: `.venv/bin/python docs/frames.py`.

The axes are computed by the code that converts poses to messages.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.body_frame import body_pose, mounting
from calm_edge.types import Float

WIDTH, HEIGHT = 960, 640
PX_PER_M = 62.0
RPY_DEG, XYZ_M = (0.0, -12.0, 18.0), (0.9, -0.4, -1.0)
COLORS = {"x": "#c0392b", "y": "#1e8449", "z": "#2156a5"}
INK, CAR, ROAD = "#222", "#e8eaed", "#9aa0a6"


class View:
    """A drawing in body or local coordinates, projected along one axis."""

    def __init__(self, origin_px: tuple[float, float], right: int, up: int, up_sign: float) -> None:
        self._origin = np.array(origin_px)
        self._right, self._up, self._sign = right, up, up_sign
        self.parts: list[str] = []

    def px(self, p: Float, dx: float = 0.0, dy: float = 0.0) -> Float:
        """Page position (2,) px of a point (3,) m, shifted by (dx, dy) px."""
        flat = np.array([p[self._right], -self._sign * p[self._up]])
        return np.asarray(self._origin + PX_PER_M * flat + np.array([dx, dy]))

    def axes(self, T: Float, names: str, label: str, at: tuple[float, float], size: float) -> None:
        """Draw the axes of frame T (4, 4); axes along the line of sight are dots."""
        start = self.px(T[:3, 3])
        for k, name in enumerate("xyz"):
            end = self.px(T[:3, 3] + size * T[:3, k])
            color = COLORS[name]
            if np.linalg.norm(end - start) < 0.25 * size * PX_PER_M:
                self.parts.append(circle(start, 5, color))
                continue
            self.parts.append(arrow(start, end, color))
            if name in names:
                along = (end - start) / np.linalg.norm(end - start)
                self.parts.append(text(end + 13 * along + [0, 4], name, color, 15, "middle"))
        self.parts.append(text(start + np.array(at), label, INK, 13))

    def box(self, low: Float, high: Float, color: str, radius: float) -> None:
        a, b = self.px(low), self.px(high)
        x, y = np.minimum(a, b)
        w, h = np.abs(b - a)
        self.parts.append(
            f'<rect x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}" rx="{radius:g}" '
            f'fill="{color}" stroke="{INK}"/>'
        )


def circle(at: Float, radius: float, color: str) -> str:
    return f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{radius:g}" fill="{color}"/>'


def line(a: Float, b: Float, color: str, dash: str = "") -> str:
    style = f' stroke-dasharray="{dash}"' if dash else ""
    return (
        f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}" '
        f'stroke="{color}" stroke-width="1.5"{style}/>'
    )


def arrow(a: Float, b: Float, color: str) -> str:
    along = (b - a) / np.linalg.norm(b - a)
    across = np.array([-along[1], along[0]])
    tip = [b, b - 10 * along + 4 * across, b - 10 * along - 4 * across]
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in tip)
    shaft = line(a, b - 8 * along, color).replace("1.5", "3")
    return f'{shaft}<polygon points="{points}" fill="{color}"/>'


def text(at: Float, words: str, color: str = INK, size: int = 13, anchor: str = "start") -> str:
    return (
        f'<text x="{at[0]:.1f}" y="{at[1]:.1f}" fill="{color}" font-size="{size}" '
        f'text-anchor="{anchor}">{words}</text>'
    )


def side(T_b_c: Float) -> list[str]:
    """The car from its right: x to the right of the page, z down."""
    view = View((230, 210), right=0, up=2, up_sign=-1.0)
    road = 0.75
    view.parts.append(text(np.array([24, 34]), "From the side", INK, 17))
    ends = [view.px(np.array([x, 0, road])) for x in (-2.6, 4.2)]
    view.parts.append(line(ends[0], ends[1], ROAD))
    view.box(np.array([-1.1, 0, -0.45]), np.array([3.0, 0, 0.45]), CAR, 14)
    view.box(np.array([-0.6, 0, -0.95]), np.array([1.7, 0, -0.45]), CAR, 12)
    for x in (-0.2, 2.2):
        view.parts.append(circle(view.px(np.array([x, 0, 0.42])), 20, "#5f6368"))
    lever(view, T_b_c)
    level = T_b_c[:3, 3] + [1.9, 0, 0]
    view.parts.append(line(view.px(T_b_c[:3, 3]), view.px(level), INK, "4 4"))
    view.parts.append(text(view.px(level, 8, 4), "level"))
    view.parts.append(text(view.px(level, -20, 28), f"pitch {RPY_DEG[1]:g} deg: looks down"))
    view.axes(np.eye(4), "xz", "body", (-48, 20), 1.0)
    view.axes(T_b_c, "yz", "camera", (-30, -12), 1.2)
    return view.parts


def top(T_b_c: Float) -> list[str]:
    """The car from above: x up the page, y to the right."""
    view = View((700, 300), right=1, up=0, up_sign=1.0)
    view.parts.append(text(np.array([520, 34]), "From above", INK, 17))
    view.box(np.array([-1.1, -0.85, 0]), np.array([3.0, 0.85, 0]), CAR, 16)
    lever(view, T_b_c)
    ahead = T_b_c[:3, 3] + [2.0, 0, 0]
    view.parts.append(line(view.px(T_b_c[:3, 3]), view.px(ahead), INK, "4 4"))
    view.parts.append(text(view.px(ahead, -8, -10), "ahead", anchor="end"))
    view.parts.append(text(view.px(ahead, 88, 8), f"yaw +{RPY_DEG[2]:g} deg: looks right"))
    view.axes(np.eye(4), "xy", "body", (-48, 20), 1.0)
    view.axes(T_b_c, "xz", "camera", (-58, 4), 1.2)
    return view.parts


def lever(view: View, T_b_c: Float) -> None:
    view.parts.append(line(view.px(np.zeros(3)), view.px(T_b_c[:3, 3]), INK, "2 3"))


def drive(T_b_c: Float) -> list[str]:
    """LOCAL_FRD at the first pose of the body, and the body frame later in the drive."""
    view = View((90, 490), right=0, up=1, up_sign=-1.0)
    view.parts.append(text(np.array([24, 424]), "LOCAL_FRD, from above", INK, 17))
    turn = np.radians(40.0)
    # the trajectory contains the camera's pose
    T_l_b = se3.compose(se3.so3_exp(np.array([0, 0, turn])), np.array([6.4, 0.62, 0]))
    T_w_c = se3.inverse(T_b_c) @ T_l_b @ T_b_c
    T_l_b = body_pose(T_b_c, T_w_c)
    start, end = view.px(np.zeros(3)), view.px(T_l_b[:3, 3])
    middle = view.px(np.array([4.4, -0.25, 0]))
    view.parts.append(
        f'<path d="M {start[0]:.1f} {start[1]:.1f} Q {middle[0]:.1f} {middle[1]:.1f} '
        f'{end[0]:.1f} {end[1]:.1f}" fill="none" stroke="{ROAD}" stroke-width="2" '
        'stroke-dasharray="6 4"/>'
    )
    view.axes(np.eye(4), "xy", "LOCAL_FRD = the body at the first pose", (-60, -22), 0.9)
    view.axes(T_l_b, "xy", "BODY_FRD now", (-20, -18), 0.9)
    return view.parts


def page() -> str:
    """The complete SVG."""
    T_b_c = mounting(RPY_DEG, XYZ_M)
    legend = [
        text(np.array([600, 464]), "x red, y green, z blue; a dot: towards or away from you"),
        text(np.array([600, 488]), "body: x forward, y right, z down (FRD)"),
        text(np.array([600, 512]), "camera: x right, y down, z into the picture"),
        text(np.array([600, 536]), "here mounting_rpy_deg = [0, -12, 18]"),
        text(np.array([600, 560]), "and mounting_xyz_m = [0.9, -0.4, -1.0]: the dotted line"),
    ]
    parts = [*side(T_b_c), *top(T_b_c), *drive(T_b_c), *legend]
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'font-family="sans-serif">\n<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>\n'
    )
    return head + "\n".join(parts) + "\n</svg>\n"


if __name__ == "__main__":
    Path(__file__).with_name("frames.svg").write_text(page())
