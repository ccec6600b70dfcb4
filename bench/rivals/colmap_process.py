"""Child process that runs COLMAP on a job; started by file name in COLMAP's environment."""

import importlib
import json
import resource
import shutil
import sys
from pathlib import Path

import numpy as np


def main(job_file: str, answer: str) -> None:
    """Run the job in job_file and write the result to `answer`.

    Job: `images` (folder with cam0/, cam1/), `pairs` (file), `work` (folder), `names` and `t_ns` of
    the primary pictures.
    """
    job = json.loads(Path(job_file).read_text())
    colmap = importlib.import_module("pycolmap")
    colmap.set_random_seed(0)
    work = Path(job["work"])
    database, models = work / "database.db", work / "models"
    database.unlink(missing_ok=True)
    shutil.rmtree(models, ignore_errors=True)
    models.mkdir()
    colmap.extract_features(
        database,
        job["images"],
        camera_mode=colmap.CameraMode.PER_FOLDER,
        reader_options=colmap.ImageReaderOptions(camera_model="SIMPLE_PINHOLE"),
    )
    pairing = colmap.ImportedPairingOptions(match_list_path=job["pairs"])
    colmap.match_image_pairs(database, pairing_options=pairing)
    found = colmap.incremental_mapping(database, job["images"], models)
    t_ns, poses, focal = [], [], []
    if found:
        best = max(found.values(), key=lambda model: model.num_reg_images())
        stamps = dict(zip(job["names"], job["t_ns"], strict=True))
        for image in best.images.values():
            if image.name in stamps and image.has_pose:
                T = np.eye(4)
                T[:3] = image.cam_from_world().inverse().matrix()
                t_ns.append(stamps[image.name])
                poses.append(T.ravel().tolist())
        focal = [best.cameras[k].focal_length for k in sorted(best.cameras)]
    used = resource.getrusage(resource.RUSAGE_SELF)
    result = {
        "t_ns": t_ns,
        "T_w_c": poses,
        "frames": len(job["names"]),
        "cpu_s": used.ru_utime + used.ru_stime,
        "focal_px": focal,
    }
    Path(answer).write_text(json.dumps(result))


if __name__ == "__main__":
    main(*sys.argv[1:3])
