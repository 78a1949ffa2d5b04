#!/usr/bin/env python3
"""Calibrates datasets/opencv-stereo with OpenCV and writes the reference files. Run by reference.py.

    opencv_reference.py DATASET OUT

The result of each corner file: every camera alone, then both jointly, started from the former. Five
coefficients, stops at 2000 iterations or 1e-12. Translations are in units of squares in the JSON
files and in metres in the YAML files.
"""

import pathlib
import sys

import common

try:
    import cv2
    import numpy as np
except ImportError as error:
    sys.exit(f"opencv_reference.py: {error.name} is missing: pip install -r tools/reference/requirements.txt")

CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 2000, 1e-12)


def calibrate_mono(board, views):
    """Returns OpenCV's answer for one camera as a dictionary."""
    rms, matrix, distortion, rotations, translations, _, _, per_view = cv2.calibrateCameraExtended(
        [board] * len(views), views, common.IMAGE_SIZE, None, None, flags=0, criteria=CRITERIA
    )
    return {
        "rms": rms,
        "matrix": matrix,
        "distortion": distortion.reshape(-1, 1),
        "poses": np.array([np.concatenate([r.ravel(), t.ravel()]) for r, t in zip(rotations, translations)]),
        "per_view": per_view.reshape(-1, 1),
    }


def camera_json(matrix, distortion):
    return {"camera_matrix": matrix.tolist(), "distortion": distortion.ravel().tolist()}


def write_camera_yaml(path, answer):
    """Writes one camera with the keys of OpenCV's calibration sample. The time is left out on purpose."""
    poses = answer["poses"].copy()
    poses[:, 3:] *= common.SPACING_M
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("nframes", len(poses))
    storage.write("image_width", common.IMAGE_SIZE[0])
    storage.write("image_height", common.IMAGE_SIZE[1])
    storage.write("board_width", common.COLUMNS)
    storage.write("board_height", common.ROWS)
    storage.write("square_size", common.SPACING_M)
    storage.write("flags", 0)
    storage.write("camera_matrix", answer["matrix"])
    storage.write("distortion_coefficients", answer["distortion"])
    storage.write("avg_reprojection_error", answer["rms"])
    storage.write("per_view_reprojection_errors", answer["per_view"].astype(np.float32))
    storage.write("extrinsic_parameters", poses)
    storage.release()


def write_stereo_yaml(out, matrices, distortions, rotation, translation):
    """Writes the pair with the keys of OpenCV's stereo sample, rectification included."""
    translation = translation * common.SPACING_M
    storage = cv2.FileStorage(str(out / "intrinsics.yml"), cv2.FILE_STORAGE_WRITE)
    for number, (matrix, distortion) in enumerate(zip(matrices, distortions), start=1):
        storage.write(f"M{number}", matrix)
        storage.write(f"D{number}", distortion)
    storage.release()
    rectified = cv2.stereoRectify(
        matrices[0], distortions[0], matrices[1], distortions[1], common.IMAGE_SIZE, rotation, translation
    )
    storage = cv2.FileStorage(str(out / "extrinsics.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("R", rotation)
    storage.write("T", translation)
    for key, matrix in zip(("R1", "R2", "P1", "P2", "Q"), rectified):
        storage.write(key, matrix)
    storage.release()


def main():
    dataset, out = map(pathlib.Path, sys.argv[1:3])
    # With more threads the order of sums changes from run to run.
    cv2.setNumThreads(1)
    for name in ("classic5", "classic11"):
        corners = common.read_corners(dataset / f"corners-{name}.csv")
        board = np.array(common.board(), np.float32)
        views = {camera: [np.array(view, np.float32).reshape(-1, 1, 2) for view in corners[camera]] for camera in corners}
        mono = {camera: calibrate_mono(board, views[camera]) for camera in common.CAMERAS}
        rms, m1, d1, m2, d2, rotation, translation, _, _ = cv2.stereoCalibrate(
            [board] * len(views["left"]),
            views["left"],
            views["right"],
            mono["left"]["matrix"].copy(),
            mono["left"]["distortion"].copy(),
            mono["right"]["matrix"].copy(),
            mono["right"]["distortion"].copy(),
            common.IMAGE_SIZE,
            flags=cv2.CALIB_USE_INTRINSIC_GUESS,
            criteria=CRITERIA,
        )
        common.write_json(
            out / f"opencv-{name}.json",
            {
                "tool": "OpenCV",
                "version": cv2.__version__,
                "corners": f"corners-{name}.csv",
                "criteria": {"iterations": CRITERIA[1], "epsilon": CRITERIA[2]},
                "mono": {
                    camera: {
                        **camera_json(answer["matrix"], answer["distortion"]),
                        "flags": [],
                        "rms_px": answer["rms"],
                        "rms_px_per_view": answer["per_view"].ravel().tolist(),
                    }
                    for camera, answer in mono.items()
                },
                "stereo": {
                    "flags": ["CALIB_USE_INTRINSIC_GUESS"],
                    "rms_px": rms,
                    "left": camera_json(m1, d1),
                    "right": camera_json(m2, d2),
                    "R": rotation.tolist(),
                    "R_rodrigues": cv2.Rodrigues(rotation)[0].ravel().tolist(),
                    "T_squares": translation.ravel().tolist(),
                    "T_m": (translation.ravel() * common.SPACING_M).tolist(),
                },
            },
        )
        if name == "classic5":
            for camera in common.CAMERAS:
                write_camera_yaml(out / f"{camera}.yml", mono[camera])
            write_stereo_yaml(out, (m1, m2), (d1.reshape(-1, 1), d2.reshape(-1, 1)), rotation, translation)


if __name__ == "__main__":
    main()
