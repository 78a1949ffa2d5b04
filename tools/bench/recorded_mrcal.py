#!/usr/bin/python3
"""Calibrates the corners of one recorded set with mrcal and prints one line of JSON. Run by `cargo xtask datasets --recorded`.

    /usr/bin/python3 recorded_mrcal.py SET

SET is JSON: `corners` (a .vnl), `size` (corners), `image_size`, `focal_px` (a start), `name` (a regular expression over file names
with the groups `frame` and `camera`), `lens` and `spacing_m`. All cameras jointly, a board bent by two coefficients,
regularisation and rejection on. `rms` is over corners that were kept, sqrt(sum(du² + dv²) / corners).
"""

import json
import os
import re
import sys
import time

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[variable] = "1"

import mrcal
import numpy as np

from mrcal_solve import version

# Fewer corners give no pose to start from.
LEAST = 8


def read(job):
    """Returns {(frame, camera): [rows, columns, 3]} of u, v and weight, -1 for corners that are not seen."""
    columns, rows = job["size"]
    views, places = {}, {}
    is_level = False
    for line in open(job["corners"], encoding="utf-8"):
        if line.startswith("# filename"):
            is_level = line.split()[-1] == "level"
        if line.startswith("#") or not line.strip():
            continue
        name, u, v, weight = line.split()[:4]
        place = places.get(name, 0)
        places[name] = place + 1
        if u == "-" or weight in ("-", "-1"):
            continue
        match = re.search(job["name"], name)
        key = (match["frame"], match.groupdict().get("camera") or "")
        view = views.setdefault(key, np.full((rows, columns, 3), -1.0))
        weight = 0.5 ** float(weight) if is_level else float(weight)
        view[place // columns, place % columns] = (float(u), float(v), weight)
    return {key: view for key, view in views.items() if (view[..., 2] > 0).sum() >= LEAST}


def main():
    job = json.loads(sys.argv[1])
    views = read(job)
    frames = sorted({frame for frame, _ in views})
    cameras = sorted({camera for _, camera in views})
    keys = sorted(views, key=lambda key: (frames.index(key[0]), cameras.index(key[1])))
    observations = np.array([views[key] for key in keys])
    frame_camera = np.array([(frames.index(f), cameras.index(c)) for f, c in keys], dtype=np.int32)
    image_sizes = np.array([job["image_size"]] * len(cameras), dtype=np.int32)
    spacing = job["spacing_m"]
    begin = time.process_time()
    _, extrinsics, poses = mrcal.seed_stereographic(image_sizes, job["focal_px"], frame_camera, observations, spacing)
    intrinsics = np.zeros((len(cameras), mrcal.lensmodel_num_params(job["lens"])))
    intrinsics[:, :2] = job["focal_px"]
    intrinsics[:, 2:4] = (image_sizes - 1) / 2.0
    state = {
        "intrinsics": intrinsics,
        "extrinsics_rt_fromref": np.ascontiguousarray(extrinsics).reshape(-1, 6),
        "frames_rt_toref": np.ascontiguousarray(poses).reshape(-1, 6),
        "points": None,
        "observations_board": observations,
        "indices_frame_camintrinsics_camextrinsics": np.column_stack([frame_camera, frame_camera[:, 1] - 1]).astype(np.int32),
        "observations_point": None,
        "indices_point_camintrinsics_camextrinsics": None,
        "lensmodel": job["lens"],
        "imagersizes": image_sizes,
        "calobject_warp": np.zeros(2),
        "calibration_object_spacing": spacing,
        "verbose": False,
    }
    n_seen = int((observations[..., 2] > 0).sum())
    stages = ["", "core", "core distortions", "core distortions warp", "core distortions warp"]
    for stage in stages:
        stats = mrcal.optimize(
            **state,
            do_optimize_intrinsics_core="core" in stage,
            do_optimize_intrinsics_distortions="distortions" in stage,
            do_apply_regularization="distortions" in stage,
            do_optimize_calobject_warp="warp" in stage,
            do_apply_outlier_rejection="warp" in stage,
        )
    seconds = time.process_time() - begin
    kept = observations[..., 2] > 0
    # A residual is multiplied by the corner's weight; the RMS is in pixels.
    residuals = stats["x"][: 2 * observations[..., 0].size].reshape(*observations.shape[:3], 2)
    square = ((residuals / np.where(kept, observations[..., 2], 1.0)[..., None]) ** 2).sum(-1)
    answer = {
        "version": version(),
        "lens": job["lens"],
        "views": len(keys),
        "corners": int(kept.sum()),
        "rejected": n_seen - int(kept.sum()),
        "rms": float(np.sqrt(square[kept].mean())),
        "seconds": seconds,
    }
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
