#!/usr/bin/env python3
"""Finds one AprilTag in a folder of images with OpenCV and writes its four corners as a corner CSV.

    tag_corners.py FOLDER DICTIONARY OUTPUT.csv

Points are counted as OpenCV orders a tag's corners: from the first corner of its code clockwise.
"""

import csv
import pathlib
import sys

import cv2


def main(folder, dictionary, output):
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    tags = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{dictionary}"))
    detector = cv2.aruco.ArucoDetector(tags, parameters)
    output = pathlib.Path(output)
    output.parent.mkdir(parents=True, exist_ok=True)
    with output.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["camera", "image", "view", "point", "u", "v"])
        for path in sorted(pathlib.Path(folder).glob("*.png")):
            corners, ids, _ = detector.detectMarkers(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
            if ids is None or len(ids) != 1:
                print(f"{path.name}: {0 if ids is None else len(ids)} tags; left out", file=sys.stderr)
                continue
            for point, (u, v) in enumerate(corners[0][0]):
                writer.writerow(["camera", path.name, path.stem, point, f"{u:.4f}", f"{v:.4f}"])


if __name__ == "__main__":
    main(*sys.argv[1:])
