#!/usr/bin/python3
"""Calibrates datasets/opencv-stereo with mrcal and writes the reference files. Run by reference.py.

    /usr/bin/python3 mrcal_reference.py DATASET OUT VERSION

Both cameras jointly with LENSMODEL_OPENCV5 and a board bent by two coefficients, regularisation on.
On classic5 nothing is rejected; on classic11, which holds outliers, mrcal's own rejection is on. The
left camera is the reference. mrcal's Python module belongs to the system's Python.
"""

import os
import pathlib
import sys

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[variable] = "1"

import common

try:
    import mrcal
    import numpy as np
except ImportError as error:
    sys.exit(f"mrcal_reference.py: {error.name} is missing: apt-get install mrcal python3-mrcal")

LENS = "LENSMODEL_OPENCV5"
PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
FOCAL_GUESS_PX = 500.0


def solve(corners, reject):
    """Returns mrcal's solution and its statistics, reached in stages from a guess of the focal length."""
    n_frames = len(corners["left"])
    pixels = np.array([corners[camera][frame] for frame in range(n_frames) for camera in common.CAMERAS])
    observations = np.ones((2 * n_frames, common.ROWS, common.COLUMNS, 3))
    observations[..., :2] = pixels.reshape(2 * n_frames, common.ROWS, common.COLUMNS, 2)
    frame_camera = np.array([(frame, camera) for frame in range(n_frames) for camera in range(2)], dtype=np.int32)
    image_sizes = np.array([common.IMAGE_SIZE] * 2, dtype=np.int32)

    _, extrinsics, frames = mrcal.seed_stereographic(
        image_sizes, FOCAL_GUESS_PX, frame_camera, observations, common.SPACING_M
    )
    intrinsics = np.zeros((2, len(PARAMETERS)))
    intrinsics[:, :2] = FOCAL_GUESS_PX
    intrinsics[:, 2:4] = (image_sizes - 1) / 2.0
    state = {
        "intrinsics": intrinsics,
        "extrinsics_rt_fromref": np.ascontiguousarray(extrinsics).reshape(-1, 6),
        "frames_rt_toref": np.ascontiguousarray(frames).reshape(-1, 6),
        "points": None,
        "observations_board": observations,
        "indices_frame_camintrinsics_camextrinsics": np.column_stack([frame_camera, frame_camera[:, 1] - 1]).astype(np.int32),
        "observations_point": None,
        "indices_point_camintrinsics_camextrinsics": None,
        "lensmodel": LENS,
        "imagersizes": image_sizes,
        "calobject_warp": np.zeros(2),
        "calibration_object_spacing": common.SPACING_M,
        "verbose": False,
    }
    core = {"do_optimize_intrinsics_core": True}
    distortions = {**core, "do_optimize_intrinsics_distortions": True, "do_apply_regularization": True}
    everything = {**distortions, "do_optimize_calobject_warp": True, "do_apply_outlier_rejection": reject}
    # The second round of everything starts where the first has stopped, a step short of its optimum.
    for stage in ({}, core, distortions, everything, everything):
        options = {
            "do_optimize_intrinsics_core": False,
            "do_optimize_intrinsics_distortions": False,
            "do_optimize_calobject_warp": False,
            "do_apply_regularization": False,
            "do_apply_outlier_rejection": False,
            **stage,
        }
        stats = mrcal.optimize(**state, **options)
    return state, stats


def main():
    dataset, out = map(pathlib.Path, sys.argv[1:3])
    version = sys.argv[3]
    for name, reject in (("classic5", False), ("classic11", True)):
        state, stats = solve(common.read_corners(dataset / f"corners-{name}.csv"), reject)
        observations = state["observations_board"]
        residuals = stats["x"][: 2 * observations[..., 0].size].reshape(-1, common.ROWS * common.COLUMNS, 2)
        kept = observations[..., 2].reshape(residuals.shape[:2]) > 0
        cameras = {}
        for number, camera in enumerate(common.CAMERAS):
            pose = state["extrinsics_rt_fromref"][number - 1] if number else np.zeros(6)
            mine = residuals[number::2][kept[number::2]]
            cameras[camera] = {
                "lensmodel": LENS,
                "intrinsics": dict(zip(PARAMETERS, state["intrinsics"][number].tolist())),
                "cam_from_ref": {
                    "rodrigues": pose[:3].tolist(),
                    "translation_m": pose[3:].tolist(),
                    "translation_squares": (pose[3:] / common.SPACING_M).tolist(),
                },
                "rms_px": float(np.sqrt((mine**2).sum() / len(mine))),
                "observations": int(kept[number::2].sum()),
                "rejected": [
                    {"view": int(view), "point": int(point)} for view, point in np.argwhere(~kept[number::2])
                ],
            }
            mrcal.cameramodel(
                intrinsics=(LENS, state["intrinsics"][number]),
                imagersize=np.array(common.IMAGE_SIZE),
                extrinsics_rt_fromref=pose,
            ).write(str(out / f"mrcal-{name}-{camera}.cameramodel"))
        common.write_json(
            out / f"mrcal-{name}.json",
            {
                "tool": "mrcal",
                "version": version,
                "corners": f"corners-{name}.csv",
                "options": {"regularization": True, "outlier_rejection": reject, "calobject_warp": True},
                "cameras": cameras,
                "calobject_warp_m": state["calobject_warp"].tolist(),
                "ref_from_board": [
                    {"rodrigues": pose[:3].tolist(), "translation_m": pose[3:].tolist()}
                    for pose in state["frames_rt_toref"]
                ],
                "cost": float(stats["x"] @ stats["x"]),
                "cost_regularization": float((stats["x"][residuals.size :] ** 2).sum()),
                "rms_px": float(np.sqrt((residuals**2).sum() / kept.sum())),
                "rms_px_mrcal": float(stats["rms_reproj_error__pixels"]),
            },
        )


if __name__ == "__main__":
    main()
