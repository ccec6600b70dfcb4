"""Presets of `map --quality`: how much depth is computed, and how dense the map is."""

from __future__ import annotations

from typing import Any

# Configuration that a preset sets over that of the recording. Time grows with the number of views
# that get depth and with the area of the depth maps; a map of few points also draws sooner.
PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    "preview": {
        "backbone": {"depth_side_px": 120, "depth_every": 3},
        "mapping": {"grid": 16, "cloud_voxel": 0.4},
    },
    "normal": {},
    "fine": {
        "backbone": {"depth_side_px": 288},
        "mapping": {"grid": 32, "cloud_voxel": 0.1, "max_points_per_submap": 600_000},
    },
}
