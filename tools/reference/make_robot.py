#!/usr/bin/env python3
"""Makes datasets/robot-plane and datasets/robot-locate: touches, parts and points with their truth.

    make_robot.py datasets

Needs numpy only. The seed is fixed; truth.json holds what the tables were made from.
"""

import csv
import json
import pathlib
import sys

try:
    import numpy as np
except ImportError:
    sys.exit("make_robot.py: numpy is missing: apt-get install python3-numpy, or use the venv of reference.py")

SEED = 20261122
IMAGE_SIZE = (1600, 1200)
# fx fy cx cy k1 k2 p1 p2 k3
LENS = (1400.0, 1398.0, 803.0, 597.0, -0.25, 0.08, 0.0005, -0.0003, 0.0)
SIGMA_PX, SIGMA_TOUCH_MM = 0.1, 0.1
MIDDLE_MM = np.array([400.0, -100.0, 20.0])
SLOPES = (0.004, -0.003)
DISTANCE_MM = 500.0
TILT_DEG = 4.0


def rotation(rodrigues):
    """Returns the rotation matrix of a Rodrigues vector."""
    angle = np.linalg.norm(rodrigues)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = np.asarray(rodrigues) / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def project(point_in_cam):
    """Returns the pixel of a point: OpenCV's five coefficients."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = LENS
    x, y = point_in_cam[0] / point_in_cam[2], point_in_cam[1] / point_in_cam[2]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.array([fx * u + cx, fy * v + cy])


def write_camera(path):
    """Writes the lens as OpenCV's calibration sample does."""
    fx, fy, cx, cy, *distortion = LENS
    path.write_text(
        "%YAML:1.0\n---\n"
        f"image_width: {IMAGE_SIZE[0]}\nimage_height: {IMAGE_SIZE[1]}\n"
        "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        f"   data: [ {fx!r}, 0., {cx!r}, 0., {fy!r}, {cy!r}, 0., 0., 1. ]\n"
        "distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n"
        f"   data: [ {', '.join(repr(k) for k in distortion)} ]\n"
    )


def write_table(path, header, rows):
    """Writes a table; numbers to four decimals."""
    with open(path, "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for row in rows:
            writer.writerow([f"{x:.4f}" if isinstance(x, float) else x for x in row])


def on_plane(x, y):
    """Returns the point of the plane in the base frame, in mm, by its place about the middle."""
    return MIDDLE_MM + [x, y, SLOPES[0] * x + SLOPES[1] * y]


def make_plane(folder, rng):
    """Nine touches, a pattern, and parts on and above the plane."""
    folder.mkdir(exist_ok=True)
    write_camera(folder / "camera.yml")
    down = rotation([0, 0, 0.3]) @ rotation([np.pi, 0, 0])
    base_from_cam = down @ rotation(np.radians(TILT_DEG) * np.array([0.8, 0.6, 0.0]))
    place = MIDDLE_MM - base_from_cam @ [0, 0, DISTANCE_MM]

    def pixel(point):
        return project(base_from_cam.T @ (point - place))

    touches, pattern = [], []
    for i in range(9):
        # The pattern's y runs against the robot's, as the camera sees it from above.
        column, line = i % 3, i // 3
        point = on_plane(150.0 * (column - 1), -120.0 * (line - 1))
        seen = pixel(point) + rng.normal(0, SIGMA_PX, 2)
        touched = point + rng.normal(0, SIGMA_TOUCH_MM, 3)
        touches.append([f"p{i}", *map(float, seen), *map(float, touched)])
    for line in range(5):
        for column in range(5):
            point = on_plane(75.0 * (column - 2), -60.0 * (line - 2))
            seen = pixel(point) + rng.normal(0, SIGMA_PX, 2)
            corner = {(c, l): f"p{(l // 2) * 3 + c // 2}" for c in (0, 2, 4) for l in (0, 2, 4)}
            name = corner.get((column, line), f"q{line}{column}")
            pattern.append([name, 75.0 * column, 60.0 * line, *map(float, seen)])
    write_table(folder / "touches.csv", ["name", "u_px", "v_px", "x_mm", "y_mm", "z_mm"], touches)
    write_table(folder / "pattern.csv", ["name", "x_mm", "y_mm", "u_px", "v_px"], pattern)

    objects, truth = [], []
    for name, x, y, turn, height in [("a", 60.0, 40.0, 25.0, 0.0), ("b", -110.0, 70.0, -140.0, 0.0), ("c", 140.0, -90.0, 80.0, 10.0)]:
        point = on_plane(x, y)
        point[2] += height
        ahead = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn)), 0.0])
        ahead[2] = SLOPES[0] * ahead[0] + SLOPES[1] * ahead[1]
        seen, step = pixel(point), pixel(point + 0.01 * ahead) - pixel(point - 0.01 * ahead)
        phi = np.degrees(np.arctan2(step[1], step[0]))
        seen = seen + rng.normal(0, SIGMA_PX, 2)
        objects.append([name, *map(float, seen), float(phi + rng.normal(0, 0.1)), height])
        truth.append({"name": name, "position_mm": list(map(float, point)), "turn_deg": turn})
    write_table(folder / "objects.csv", ["name", "u_px", "v_px", "phi_deg", "height_mm"], objects)
    document = {
        "lens": LENS,
        "base_from_cam": {"rotation_matrix": base_from_cam.tolist(), "translation_mm": place.tolist()},
        "middle_mm": MIDDLE_MM.tolist(),
        "slopes": SLOPES,
        "objects": truth,
    }
    (folder / "truth.json").write_text(json.dumps(document, indent=1) + "\n")


def make_locate(folder, rng):
    """Three points, and the same with two more, of a part in one image."""
    folder.mkdir(exist_ok=True)
    write_camera(folder / "camera.yml")
    cam_from_object = rotation([0.5, -0.4, 0.9])
    place = np.array([20.0, -15.0, 480.0])
    points = {"A": (0.0, 0.0, 0.0), "B": (60.0, 0.0, 0.0), "C": (10.0, 50.0, 0.0), "D": (55.0, 45.0, 30.0), "E": (5.0, 20.0, 25.0)}
    rows = []
    for name, point in points.items():
        seen = project(cam_from_object @ point + place) + rng.normal(0, SIGMA_PX, 2)
        rows.append([name, *point, *map(float, seen)])
    header = ["name", "x_mm", "y_mm", "z_mm", "u_px", "v_px"]
    write_table(folder / "points.csv", header, rows)
    write_table(folder / "triangle.csv", header, rows[:3] + [row[:4] + ["", ""] for row in rows[3:]])
    document = {
        "lens": LENS,
        "cam_from_object": {"rotation_matrix": cam_from_object.tolist(), "translation_mm": place.tolist()},
    }
    (folder / "truth.json").write_text(json.dumps(document, indent=1) + "\n")


def main():
    folder = pathlib.Path(sys.argv[1])
    make_plane(folder / "robot-plane", np.random.default_rng(SEED))
    make_locate(folder / "robot-locate", np.random.default_rng(SEED + 1))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main()
