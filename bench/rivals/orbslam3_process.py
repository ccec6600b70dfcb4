"""Child process that runs ORB-SLAM3 on a job; started by file name in ORB-SLAM3's environment."""

import importlib
import json
import resource
import sys
from pathlib import Path

import cv2
import numpy as np


def main(job_file: str, answer: str) -> None:
    """Run the job in job_file and write the result to `answer`.

    Job: `settings`, `vocabulary` (files), `pairs` [[left, right, t_ns], ...], `final` (file for the
    trajectory).
    """
    job = json.loads(Path(job_file).read_text())
    orb = importlib.import_module("pyorbslam3")
    slam = orb.Slam(job["vocabulary"], job["settings"], orb.Sensor.STEREO, use_viewer=False)
    before = resource.getrusage(resource.RUSAGE_SELF)
    stamps, live = [], {}
    for left, right, t_ns in job["pairs"]:
        images = [cv2.imread(path, cv2.IMREAD_GRAYSCALE) for path in (left, right)]
        found = slam.track_stereo(*images, t_ns / 1e9)
        stamps.append(t_ns)
        if found.ok:
            live[t_ns] = np.asarray(found.pose_wc, np.float64)
    after = resource.getrusage(resource.RUSAGE_SELF)
    final = job["final"]
    slam.shutdown()
    slam.save_trajectory_euroc(final)
    poses = read_final(Path(final), stamps)
    result = {
        "t_ns": list(poses),
        "T_w_c": [T.ravel().tolist() for T in poses.values()],
        "live_t_ns": list(live),
        "live_T_w_c": [T.ravel().tolist() for T in live.values()],
        "frames": len(job["pairs"]),
        "cpu_s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
    }
    Path(answer).write_text(json.dumps(result))


def read_final(path: Path, stamps: list[int]) -> dict[int, np.ndarray]:
    """Read trajectory rows `t_ns x y z qx qy qz qw` as {stamp: T_w_c}.

    ORB-SLAM3 rounds stamps; each is replaced by the nearest of `stamps`.
    """
    out: dict[int, np.ndarray] = {}
    known = np.array(stamps)
    for line in path.read_text().splitlines() if path.is_file() else ():
        t, x, y, z, i, j, k, w = (float(v) for v in line.split())
        T = np.eye(4)
        T[:3, :3] = [
            [1 - 2 * (j * j + k * k), 2 * (i * j - k * w), 2 * (i * k + j * w)],
            [2 * (i * j + k * w), 1 - 2 * (i * i + k * k), 2 * (j * k - i * w)],
            [2 * (i * k - j * w), 2 * (j * k + i * w), 1 - 2 * (i * i + j * j)],
        ]
        T[:3, 3] = x, y, z
        out[int(known[np.abs(known - t).argmin()])] = T
    return out


if __name__ == "__main__":
    main(*sys.argv[1:3])
