"""Draw the curves of science.md: `.venv/bin/python docs/science_pictures.py REC --truth FOLDER`.

REC is a recording of the demo drive, as `make demo` leaves it in `build/demo/recording`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from calm_edge.evaluation.truth import read_truth
from calm_edge.recording.reader import Recording
from calm_edge.report import curves, map_image
from calm_edge.report.recording_report import recording_report

DOCS = Path(__file__).parent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--truth", type=Path, required=True)
    arguments = parser.parse_args()
    truth = read_truth(arguments.truth)
    data = recording_report(Recording(arguments.recording), truth, DOCS / "science.md")
    R = map_image.level_rotation(data.T_w_c)
    path = data.T_w_c[:, :3, 3] @ R.T
    true = None if data.truth_w is None else data.truth_w @ R.T
    loops = [(R @ loop.p_w, R @ loop.match_p_w) for loop in data.loops]
    focal = data.t_s, data.focal_px, data.focal_log_sigma, data.truth_focal_px, data.focal_raw_px
    drawn = {
        "science-path.svg": curves.trajectory(path, true, data.unit, loops),
        "science-focal.svg": curves.focal(*focal),
        "science-scale.svg": curves.scale(
            data.t_s, data.scale, data.scale_windows, data.scale_log_sigma
        ),
    }
    for name, both in drawn.items():
        # the wide one of the two drawings, with a background of its own
        svg = both.removeprefix('<div class="wide">').partition("</div>")[0]
        svg = svg.replace(">", '><rect width="100%" height="100%" fill="#fff"/>', 1)
        (DOCS / name).write_text(svg + "\n", "utf-8")


if __name__ == "__main__":
    main()
