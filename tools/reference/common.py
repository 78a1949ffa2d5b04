"""What the reference scripts share: the facts of datasets/opencv-stereo and how files are written."""

import csv
import json

CAMERAS = ("left", "right")
IMAGE_SIZE = (640, 480)
COLUMNS, ROWS = 9, 6
SPACING_M = 0.025


def read_corners(path):
    """Returns {camera: [view: [point: (u, v)]]}, after checking that nothing is missing or out of order."""
    corners = {camera: [] for camera in CAMERAS}
    with open(path, newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            views = corners[row["camera"]]
            view, point = int(row["view"]), int(row["point"])
            if point == 0:
                views.append([])
            if view != len(views) - 1 or point != len(views[-1]):
                raise SystemExit(f"{path}: {row['camera']} view {view} point {point} is out of order")
            if (int(row["X"]), int(row["Y"])) != (point % COLUMNS, point // COLUMNS):
                raise SystemExit(f"{path}: {row['camera']} view {view} point {point} has another place on the board")
            views[-1].append((float(row["u"]), float(row["v"])))
    for camera, views in corners.items():
        if len(views) != len(corners[CAMERAS[0]]) or any(len(view) != COLUMNS * ROWS for view in views):
            raise SystemExit(f"{path}: {camera} has incomplete views")
    return corners


def board():
    """Returns the corners of the flat board in units of squares, along the rows."""
    return [(column, row, 0) for row in range(ROWS) for column in range(COLUMNS)]


def rounded(value):
    """Returns the value with floats cut to 12 digits, so that another machine's last bits do not show."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.12g}")
    return value


def write_json(path, value):
    with open(path, "w", encoding="utf-8") as file:
        json.dump(rounded(value), file, indent=1, sort_keys=True)
        file.write("\n")
