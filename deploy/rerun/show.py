"""Show a recording in rerun: the car on its path, both images, focal lengths, pose age.

    pip install rerun-sdk
    python deploy/rerun/show.py drives/monday

With --save FILE.rrd it is written to a file, which `rerun FILE.rrd` shows the same way.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import rerun
from rerun import blueprint


def layout() -> blueprint.Blueprint:
    """Views at the end of the recording, as in deploy/foxglove/calm-edge.json."""
    eyes = "primary", "assistant"
    behind = blueprint.EyeControls3D(
        position=(-14.0, 9.0, 11.0), look_target=(6.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0)
    )
    drive = blueprint.Spatial3DView(
        origin="/", contents=["/**"], name="car on its path, landmarks", eye_controls=behind
    )
    images = [blueprint.Spatial2DView(origin=f"/{eye}/image", name=eye) for eye in eyes]
    focals = [
        blueprint.TimeSeriesView(origin=f"/plot/{eye}/focal_px", name=f"focal length [px], {eye}")
        for eye in eyes
    ]
    pose = blueprint.TimeSeriesView(origin="/plot/pose_age_ms", name="age of the pose [ms]")
    lengths = blueprint.TimeSeriesView(
        origin="/plot/length_sigma_percent", name="sigma of lengths [%]"
    )
    return blueprint.Blueprint(
        blueprint.Horizontal(
            drive,
            blueprint.Vertical(
                blueprint.Horizontal(*images),
                blueprint.Horizontal(*focals),
                blueprint.Tabs(lengths, pose),
            ),
            column_shares=[1.0, 1.3],
        ),
        blueprint.TimePanel(state="collapsed", play_state="following", timeline="message_log_time"),
        blueprint.SelectionPanel(state="hidden"),
        blueprint.BlueprintPanel(state="hidden"),
    )


def main() -> None:
    """Send all segments of a recording, then the layout, to the viewer or a file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path, help="a recording folder or an MCAP file")
    parser.add_argument("--save", type=Path, metavar="FILE", help="write an .rrd instead")
    options = parser.parse_args()
    files = sorted(options.recording.glob("*.mcap")) or [options.recording]
    rerun.init("calm-edge", spawn=options.save is None)
    if options.save is not None:
        rerun.save(options.save)
    for file in files:
        rerun.log_file_from_path(file)
    rerun.send_blueprint(layout())


if __name__ == "__main__":
    main()
