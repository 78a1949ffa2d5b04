#!/usr/bin/env python3
"""Finds the corners of datasets/opencv-stereo again, from the photographs of Debian's opencv-doc.

    detect_corners.py [--images DIR] [--window 5|11] > corners.csv

This is how the two committed corner files were made: OpenCV's classic detector on the grey image,
then cornerSubPix with a half window of 5 or of 11 pixels, 30 rounds, 0.01 px. Bit-identical results need the OpenCV
version of requirements.txt.
"""

import argparse
import pathlib
import sys

try:
    import cv2
except ImportError as error:
    sys.exit(f"detect_corners.py: {error.name} is missing: pip install -r tools/reference/requirements.txt")

COLUMNS, ROWS = 9, 6
# The recording has no tenth pair.
NUMBERS = [1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", default="/usr/share/doc/opencv-doc/examples/data")
    parser.add_argument("--window", type=int, default=5, help="half window of cornerSubPix")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    folder = pathlib.Path(args.images)
    print("camera,image,view,point,X,Y,Z,u,v")
    for camera in ("left", "right"):
        for view, number in enumerate(NUMBERS):
            name = f"{camera}{number:02}.jpg"
            image = cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE)
            if image is None:
                sys.exit(f"detect_corners.py: cannot read {folder / name}: apt-get install opencv-doc")
            flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
            found, corners = cv2.findChessboardCorners(image, (COLUMNS, ROWS), flags=flags)
            if not found:
                sys.exit(f"detect_corners.py: no {COLUMNS}x{ROWS} board found in {name}")
            criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.01)
            corners = cv2.cornerSubPix(image, corners, (args.window, args.window), (-1, -1), criteria)
            for point, (u, v) in enumerate(corners.reshape(-1, 2)):
                print(f"{camera},{name},{view},{point},{point % COLUMNS},{point // COLUMNS},0,{u:.9g},{v:.9g}")


if __name__ == "__main__":
    main()
