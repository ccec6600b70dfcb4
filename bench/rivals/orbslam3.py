"""ORB-SLAM3 stereo (PyPI `pyorbslam3`, GPL-3.0, hence in a separate process)."""

from __future__ import annotations

from pathlib import Path

from bench.drives import pictures
from bench.rivals.calibration import Calibration, nearest_pairs
from bench.rivals.environment import (
    RIVALS,
    RivalRun,
    environment,
    run_process,
)
from bench.rivals.vocabulary import vocabulary_of
from calm_edge.recording.sequence_folder import SequenceFolder
from device.frame import Eye

PACKAGES = ("pyorbslam3==0.1.1", "numpy", "opencv-python-headless")
SCRIPT = Path(__file__).with_name("orbslam3_process.py")

# Values from ORB-SLAM3's settings for KITTI.
_FEATURES = {
    "ORBextractor.nFeatures": 2000,
    "ORBextractor.scaleFactor": 1.2,
    "ORBextractor.nLevels": 8,
    "ORBextractor.iniThFAST": 20,
    "ORBextractor.minThFAST": 7,
    "Stereo.ThDepth": 60.0,
}
# ORB-SLAM3 requires these even without a viewer.
_VIEWER = {
    "KeyFrameSize": 0.05,
    "KeyFrameLineWidth": 1.0,
    "GraphLineWidth": 0.9,
    "PointSize": 2.0,
    "CameraSize": 0.08,
    "CameraLineWidth": 3.0,
    "ViewpointX": 0.0,
    "ViewpointY": -0.7,
    "ViewpointZ": -1.8,
    "ViewpointF": 500.0,
    "imageViewScale": 1.0,
}


def settings(calibration: Calibration, rate_hz: float) -> str:
    """Text of ORB-SLAM3's settings file: two pinhole cameras and the rig, without loop closing."""
    width, height = calibration.size
    lines = ["%YAML:1.0", 'File.version: "1.0"', 'Camera.type: "PinHole"']
    for eye, camera in enumerate(calibration.cameras, 1):
        values = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}
        values |= dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0)
        lines += [f"Camera{eye}.{name}: {float(value):.9f}" for name, value in values.items()]
    lines += [f"Camera.width: {width}", f"Camera.height: {height}"]
    lines += [f"Camera.fps: {round(rate_hz)}", "Camera.RGB: 1"]
    data = ", ".join(f"{v:.12f}" for v in calibration.T_p_a.ravel())
    lines += ["Stereo.T_c1_c2: !!opencv-matrix", "  rows: 4", "  cols: 4", "  dt: f"]
    lines += [f"  data: [{data}]"]
    lines += [f"{name}: {value}" for name, value in _FEATURES.items()]
    # the vocabulary of one drive gives false loops, which can crash ORB-SLAM3
    lines += ["loopClosing: 0"]
    lines += [f"Viewer.{name}: {value}" for name, value in _VIEWER.items()]
    return "\n".join(lines) + "\n"


def run(folder: Path, calibration: Calibration, work: Path, shift: int = 0) -> RivalRun:
    """Run ORB-SLAM3 on each primary frame and the assistant frame nearest in time.

    shift: number of frames by which the assistant's stream is shifted. Returns the final
    trajectory, after all corrections. Raises RivalMissing, EvaluationError.
    """
    folder = folder.resolve()
    python = environment("orbslam3", *PACKAGES)
    sequence = SequenceFolder(folder)
    files = [pictures(folder, eye) for eye in Eye]
    t_ns = [sequence.t_ns(eye) for eye in Eye]
    work.mkdir(parents=True, exist_ok=True)
    vocabulary = vocabulary_of(files[0], RIVALS / "vocabulary" / f"{folder.name}.txt")
    rate_hz = 1e9 * (len(t_ns[0]) - 1) / max(int(t_ns[0][-1] - t_ns[0][0]), 1)
    (work / "settings.yaml").write_text(settings(calibration, rate_hz))
    pairs = [
        [str(files[0][i]), str(files[1][j]), int(t_ns[0][i])]
        for i, j in nearest_pairs(t_ns[0], t_ns[1], shift)
    ]
    job = {
        "settings": str(work / "settings.yaml"),
        "vocabulary": str(vocabulary),
        "pairs": pairs,
        "final": str(work / "final.txt"),
    }
    return run_process(python, SCRIPT, job, work)
