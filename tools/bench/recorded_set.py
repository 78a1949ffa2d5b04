#!/usr/bin/env python3
"""Calibrates one recorded set with Boresight and with OpenCV, and prints one line of JSON. Run by `cargo xtask datasets --recorded`.

    recorded_set.py SET

SET is JSON: `program` and `arguments` of ours, `out` the folder of its results; for OpenCV `folder`, `kind` (chessboard or
charuco), `size` (corners), `images` (a list of patterns within the folder, one a camera) or `corners` (a .vnl) with
`image_size`, and `name` (a regular expression over file names with the groups `frame` and, where there are several
cameras, `camera`). A set without `kind` is ours alone.

Seconds are CPU time, all threads. Ours are the whole command, with its held-out error; OpenCV's are detection and
calibration, without.
"""

import json
import pathlib
import re
import resource
import subprocess
import sys
import time

import cv2
import numpy as np

CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-12)
# Fewer corners give no pose that is worth having.
LEAST = 8
# As ours: each frame alone where there are few, else this many parts.
FEW_FRAMES, FOLDS = 20, 5


def ours(job):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    out = pathlib.Path(job["out"])
    # What was detected before would be remembered.
    for name in ("calibration.json", "detections.json"):
        (out / name).unlink(missing_ok=True)
    run = subprocess.run(
        [job["program"], "calibrate", *job["arguments"], "-o", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        encoding="utf-8",
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    answer = {
        "code": run.returncode,
        "seconds": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
    }
    path = out / "calibration.json"
    if not path.is_file():
        lines = [line for line in run.stderr.splitlines() if line.startswith("error")]
        return {**answer, "why": lines[0] if lines else run.stderr.strip().splitlines()[-1]}
    found = json.loads(path.read_text())
    cameras = found["cameras"]
    held_out = found.get("held_out") or {}
    focal = [camera["params"]["fx"]["value"] for camera in cameras if camera["params"] and "fx" in camera["params"]]
    return {
        **answer,
        "views": sum(camera["views"] for camera in cameras),
        "corners": sum(camera["observations"] for camera in cameras),
        "rejected": sum(camera["rejected"] for camera in cameras),
        "uncalibrated": [camera["name"] for camera in cameras if camera["params"] is None],
        "rms": found["rms_px"],
        "held_out": held_out.get("rms_px"),
        "ratio": held_out.get("ratio"),
        "focal_px": focal[0] if focal else None,
        "findings": [[finding["code"], finding["severity"]] for finding in found["findings"]],
    }


def board(columns, rows):
    return np.array([[i % columns, i // columns, 0] for i in range(columns * rows)], np.float32)


def detect_chessboard(image, size):
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCorners(image, size, flags=flags)
    if not found:
        return None
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 0.001)
    corners = cv2.cornerSubPix(image, corners, (8, 8), (-1, -1), criteria)
    return np.arange(len(corners)), corners.reshape(-1, 2)


def charuco_detector(squares):
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
    return cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard(squares, 1.0, 0.75, dictionary))


def detect_charuco(image, detector):
    corners, ids = detector.detectBoard(image)[:2]
    if corners is None or len(corners) < LEAST:
        return None
    return ids.ravel(), corners.reshape(-1, 2)


def seen_in_images(job):
    """Returns {camera: {frame: (ids, pixels)}}, {camera: image size} and the number of images."""
    columns, rows = job["size"]
    detector = charuco_detector((columns + 1, rows + 1)) if job["kind"] == "charuco" else None
    seen, sizes, count = {}, {}, 0
    for number, pattern in enumerate(job["images"]):
        files = sorted(path for path in pathlib.Path(job["folder"]).glob(pattern) if path.suffix.lower() in (".png", ".jpg"))
        images = {path: cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in files}
        shapes = [image.shape for image in images.values()]
        usual = max(set(shapes), key=shapes.count)
        count += len(files)
        sizes[number] = (usual[1], usual[0])
        views = seen.setdefault(number, {})
        for path, image in images.items():
            if image.shape != usual:
                continue
            found = detect_charuco(image, detector) if detector else detect_chessboard(image, (columns, rows))
            if found is not None:
                match = re.search(job["name"], str(path.relative_to(job["folder"])))
                views[match["frame"]] = found
    return seen, sizes, count


def seen_in_corners(job):
    corners, names = {}, {}
    for line in open(job["corners"], encoding="utf-8"):
        if line.startswith("#") or not line.strip():
            continue
        name, u, v, weight = line.split()[:4]
        place = names.setdefault(name, 0)
        names[name] += 1
        if u != "-" and weight not in ("-", "-1"):
            corners.setdefault(name, []).append((place, float(u), float(v)))
    seen, cameras = {}, {}
    for name, points in corners.items():
        match = re.search(job["name"], name)
        camera = match.groupdict().get("camera") or ""
        number = cameras.setdefault(camera, len(cameras))
        if len(points) >= LEAST:
            points = np.array(points)
            seen.setdefault(number, {})[match["frame"]] = (points[:, 0].astype(int), points[:, 1:].astype(np.float32))
    return seen, {number: tuple(job["image_size"]) for number in seen}, len(names)


def calibrate(points, views, image_size):
    frames = sorted(views)
    objects = [points[views[frame][0]].reshape(-1, 1, 3) for frame in frames]
    pixels = [views[frame][1].reshape(-1, 1, 2).astype(np.float32) for frame in frames]
    return cv2.calibrateCamera(objects, pixels, image_size, None, None, criteria=CRITERIA)[:3]


def held_out(points, views, image_size):
    """Returns the sum of squares on frames that were left out, and its degrees of freedom."""
    frames = sorted(views)
    folds = len(frames) if len(frames) <= FEW_FRAMES else FOLDS
    square, freedom = 0.0, 0
    for fold in range(folds):
        tested = frames[fold::folds]
        training = {frame: views[frame] for frame in frames if frame not in tested}
        if len(training) < 3:
            continue
        _, matrix, distortion = calibrate(points, training, image_size)
        for frame in tested:
            ids, pixels = views[frame]
            shown, pixels = points[ids].reshape(-1, 1, 3), pixels.reshape(-1, 1, 2).astype(np.float64)
            good, turn, shift = cv2.solvePnP(shown, pixels, matrix, distortion)
            if not good:
                continue
            turn, shift = cv2.solvePnPRefineLM(shown, pixels, matrix, distortion, turn, shift)
            expected = cv2.projectPoints(shown, turn, shift, matrix, distortion)[0]
            square += float(((expected - pixels) ** 2).sum())
            freedom += 2 * len(ids) - 6
    return square, freedom


def opencv(job):
    cv2.setNumThreads(1)
    begin = time.process_time()
    seen, sizes, count = (seen_in_corners if job.get("corners") else seen_in_images)(job)
    points = board(*job["size"])
    answer = {"version": cv2.__version__, "images": count, "views": sum(len(views) for views in seen.values())}
    answer["corners"] = int(sum(len(ids) for views in seen.values() for ids, _ in views.values()))
    answer["cameras"] = len(seen)
    if any(len(views) < 3 for views in seen.values()):
        return {**answer, "why": "the board was found in fewer than 3 images"}
    try:
        alone = {camera: calibrate(points, views, sizes[camera]) for camera, views in seen.items()}
        square = sum(
            alone[camera][0] ** 2 * sum(len(ids) for ids, _ in views.values()) for camera, views in seen.items()
        )
        answer["rms"] = (square / answer["corners"]) ** 0.5
        if len(seen) == 2:
            both = sorted(set(seen[0]) & set(seen[1]))
            both = [frame for frame in both if np.array_equal(seen[0][frame][0], seen[1][frame][0])]
            (_, m0, d0), (_, m1, d1) = alone[0], alone[1]
            answer["joint_rms"] = cv2.stereoCalibrate(
                [points[seen[0][frame][0]].reshape(-1, 1, 3) for frame in both],
                [seen[0][frame][1].reshape(-1, 1, 2).astype(np.float32) for frame in both],
                [seen[1][frame][1].reshape(-1, 1, 2).astype(np.float32) for frame in both],
                m0, d0, m1, d1, sizes[0], flags=cv2.CALIB_USE_INTRINSIC_GUESS, criteria=CRITERIA,
            )[0]
        answer["seconds"] = time.process_time() - begin
        sums = [held_out(points, views, sizes[camera]) for camera, views in seen.items()]
        square, freedom = (sum(part) for part in zip(*sums))
        answer["held_out"] = (2 * square / freedom) ** 0.5 if freedom > 0 else None
    except cv2.error as error:
        answer["why"] = str(error).strip().splitlines()[0]
    return answer


def main():
    job = json.loads(sys.argv[1])
    answer = {"ours": ours(job)}
    if job.get("kind"):
        answer["opencv"] = opencv(job)
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
