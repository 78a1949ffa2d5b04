#!/usr/bin/env python3
"""Compares detectors on recorded sets: calibration error on the same corners, and CPU time on the same images.

    detection.py PROGRAM DATASETS [--repeats N]

PROGRAM is our example detect_images, DATASETS the folder of recorded sets. Prints one line of JSON. All on one thread.

- Corners: for each set, the corners that all detectors found (SB, classic + cornerSubPix(8), ours; for ChArUco OpenCV's
  detector, cornerSubPix(8) on its corners, ours) are calibrated with OpenCV's five-parameter model; the error is its
  RMS.
- Time: least of N runs of each detector per image, summed over all images of a set. OpenCV's classic detector is timed
  with cornerSubPix(8).
"""

import argparse
import json
import pathlib
import subprocess
import sys
import tempfile
import time

import cv2
import numpy as np

CHESS = [
    ("stereo-opencv-left-right", "raw/left*.jpg", (9, 6)),
    ("stereo-opencv-left-right", "raw/right*.jpg", (9, 6)),
    ("mono-lifecam-photonvision", "raw/640x480/*", (10, 10)),
    ("mono-lifecam-photonvision", "raw/1280x720/*", (10, 10)),
    ("corners-picam-photonvision", "raw/640x480/*", (7, 7)),
    ("wide-udacity-gopro", "raw/*", (8, 6)),
    ("rig3-trinocular-boofcv", "raw/left/*", (13, 9)),
]
CHARUCO = [
    ("charuco-lifecam-photonvision", "raw/640x480/*"),
    ("charuco-lifecam-photonvision", "raw/1280x720/*"),
]
IMAGES = {".png", ".jpg", ".jpeg", ".JPG"}


def timed(function, repeats):
    best, answer = float("inf"), None
    for _ in range(repeats):
        begin = time.thread_time()
        answer = function()
        best = min(best, time.thread_time() - begin)
    return best, answer


def refined(image, corners, window):
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 0.001)
    corners = np.ascontiguousarray(corners.reshape(-1, 1, 2), dtype=np.float32)
    return cv2.cornerSubPix(image, corners.copy(), (window, window), (-1, -1), criteria).reshape(-1, 2)


def rms(views, image_size):
    """Returns OpenCV's RMS of (points, pixels) of views."""
    objects = [points.astype(np.float32).reshape(-1, 1, 3) for points, _ in views]
    images = [pixels.astype(np.float32).reshape(-1, 1, 2) for _, pixels in views]
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-12)
    return cv2.calibrateCamera(objects, images, image_size, None, None, criteria=criteria)[0]


def load(folder, pattern):
    files = sorted(path for path in folder.glob(pattern) if path.suffix in IMAGES)
    images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in files]
    size = max({image.shape for image in images}, key=[image.shape for image in images].count)
    return [image for image in images if image.shape == size], (size[1], size[0])


def ours(program, spec, images, repeats):
    with tempfile.TemporaryDirectory() as folder:
        names = []
        for i, image in enumerate(images):
            names.append(f"{folder}/{i:04}.pgm")
            cv2.imwrite(names[-1], image)
        text = subprocess.run([program, spec, str(repeats), *names], check=True, stdout=subprocess.PIPE).stdout
    return [json.loads(line) for line in text.decode().splitlines()]


def grid(columns, rows):
    return np.array([[i % columns, i // columns, 0] for i in range(columns * rows)], float)


def chess(program, folder, name, pattern, size, repeats):
    images, image_size = load(folder / name, pattern)
    points = grid(*size)
    found = ours(program, f"chessboard:{size[0]}x{size[1]}", images, repeats)
    views = {"ours": [], "sb": [], "subpix8": []}
    seconds = {"ours": 0.0, "classic": 0.0, "sb": 0.0}
    counts = {"ours": 0, "classic": 0, "sb": 0}
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    for image, mine in zip(images, found):
        def classic():
            ok, corners = cv2.findChessboardCorners(image, size, flags=flags)
            return refined(image, corners, 8) if ok else None
        classic_s, corners8 = timed(classic, repeats)
        sb_s, (ok, corners_sb) = timed(lambda: cv2.findChessboardCornersSB(image, size), repeats)
        seconds["ours"] += mine["cpu_s"]
        seconds["classic"] += classic_s
        seconds["sb"] += sb_s
        corners = np.array(mine["corners"], float).reshape(-1, 4)
        counts["ours"] += len(corners) == len(points)
        counts["classic"] += corners8 is not None
        counts["sb"] += bool(ok)
        if not ok or corners8 is None or len(corners) < 12:
            continue
        ids = corners[:, 0].astype(int)
        # The order of ours is the one that the others are brought into.
        full = np.full((len(points), 2), np.nan)
        full[ids] = corners[:, 1:3]
        def like(theirs):
            columns, rows = size
            grids = [theirs.reshape(rows, columns, 2)]
            grids += [grids[0][::-1, ::-1]]
            if columns == rows:
                other = grids[0].transpose(1, 0, 2)
                grids += [other[::-1], other[:, ::-1]]
            grids = [g.reshape(-1, 2) for g in grids]
            return min(grids, key=lambda g: np.nanmedian(np.linalg.norm(g - full, axis=1)))
        theirs_sb, theirs8 = like(corners_sb.reshape(-1, 2)), like(corners8)
        views["ours"].append((points[ids], corners[:, 1:3]))
        views["sb"].append((points[ids], theirs_sb[ids]))
        views["subpix8"].append((points[ids], theirs8[ids]))
    errors = {key: rms(value, image_size) for key, value in views.items()}
    return {"set": f"{name} {pattern}", "images": len(images), "size": image_size, "views": len(views["ours"]),
            "corners": int(sum(len(view[0]) for view in views["ours"])), "rms": errors, "found": counts,
            "seconds": seconds}


def charuco(program, folder, name, pattern, repeats):
    images, image_size = load(folder / name, pattern)
    board = cv2.aruco.CharucoBoard(
        (8, 8), 1.0, 0.75, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000))
    detector = cv2.aruco.CharucoDetector(board)
    points = grid(7, 7)
    found = ours(program, "charuco:8x8:0.75:4x4_1000", images, repeats)
    views = {"ours": [], "opencv": [], "subpix8": []}
    seconds, counts = {"ours": 0.0, "opencv": 0.0}, {"ours": 0, "opencv": 0}
    for image, mine in zip(images, found):
        opencv_s, answer = timed(lambda: detector.detectBoard(image), repeats)
        seconds["ours"] += mine["cpu_s"]
        seconds["opencv"] += opencv_s
        corners = np.array(mine["corners"], float).reshape(-1, 4)
        counts["ours"] += len(corners) >= 6
        if answer[0] is None or len(answer[0]) < 6:
            continue
        counts["opencv"] += 1
        theirs = dict(zip(answer[1].ravel().tolist(), answer[0].reshape(-1, 2)))
        both = [row for row in corners if int(row[0]) in theirs]
        if len(both) < 12:
            continue
        both = np.array(both)
        ids = both[:, 0].astype(int)
        opencv = np.array([theirs[i] for i in ids])
        views["ours"].append((points[ids], both[:, 1:3]))
        views["opencv"].append((points[ids], opencv))
        views["subpix8"].append((points[ids], refined(image, opencv, 8)))
    errors = {key: rms(value, image_size) for key, value in views.items()}
    return {"set": f"{name} {pattern}", "images": len(images), "size": image_size, "views": len(views["ours"]),
            "corners": int(sum(len(view[0]) for view in views["ours"])), "rms": errors, "found": counts,
            "seconds": seconds}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("datasets", type=pathlib.Path)
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    answers = {"opencv": cv2.__version__, "chess": [], "charuco": []}
    for name, pattern, size in CHESS:
        if (args.datasets / name).is_dir():
            answers["chess"].append(chess(args.program, args.datasets, name, pattern, size, args.repeats))
            print(answers["chess"][-1], file=sys.stderr)
    for name, pattern in CHARUCO:
        if (args.datasets / name).is_dir():
            answers["charuco"].append(charuco(args.program, args.datasets, name, pattern, args.repeats))
            print(answers["charuco"][-1], file=sys.stderr)
    print(json.dumps(answers))


if __name__ == "__main__":
    main()
