#!/usr/bin/env python3
"""Makes datasets/rig4-synthetic: four cameras, a bent chessboard and the truth behind both.

    make_rig4.py datasets/rig4-synthetic

Writes corners.csv and truth.json. Needs numpy only. The seed is fixed; with the numpy version of
requirements.txt the same bytes come out. All parameters are rounded before the corners are projected,
so truth.json is exact.
"""

import csv
import json
import pathlib
import sys

try:
    import numpy as np
except ImportError:
    sys.exit("make_rig4.py: numpy is missing: apt-get install python3-numpy, or use the venv of reference.py")

SEED = 20260701
N_CAMERAS, N_FRAMES = 4, 40
IMAGE_SIZE = (1600, 1200)
COLUMNS, ROWS, SPACING_M = 10, 7, 0.060
# How far the middle of the board stands out along its z, from the bend in x and from that in y.
SHAPE_M = (0.0008, -0.0005)
SIGMA_PX = 0.2
BASELINE_M = 0.4
LARGEST_TILT_RAD = np.radians(40)
# Detectors need some image around a corner.
MARGIN_PX = 3.0
PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


def rotation(rodrigues):
    """Returns the rotation matrix of a Rodrigues vector."""
    angle = np.linalg.norm(rodrigues)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = rodrigues / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def rodrigues_of(matrix):
    """Returns the Rodrigues vector of a rotation matrix whose angle is well below pi."""
    axis = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]) / 2
    sine = np.linalg.norm(axis)
    if sine < 1e-12:
        return axis
    return axis / sine * np.arctan2(sine, (np.trace(matrix) - 1) / 2)


def pose(matrix, translation):
    """Returns a pose as Rodrigues vector and translation, rounded."""
    return np.round(np.concatenate([rodrigues_of(matrix), translation]), 9) + 0.0


def transform(pose, points):
    return points @ rotation(pose[:3]).T + pose[3:]


def board():
    """Returns the corners of the bent board in metres, along the rows."""
    row, column = np.divmod(np.arange(COLUMNS * ROWS), COLUMNS)
    xr, yr = column / (COLUMNS - 1), row / (ROWS - 1)
    z = SHAPE_M[0] * 4 * xr * (1 - xr) + SHAPE_M[1] * 4 * yr * (1 - yr)
    return np.stack([column * SPACING_M, row * SPACING_M, z], axis=1)


def lens(rng):
    """Returns fx, fy, cx, cy, k1, k2, p1, p2, k3 of one camera."""
    focal = rng.uniform(1150, 1250)
    core = [focal, focal * (1 + rng.uniform(-1e-3, 1e-3)), 799.5 + rng.uniform(-25, 25), 599.5 + rng.uniform(-25, 25)]
    core = np.round(core, 3)
    coefficients = [
        rng.uniform(-0.30, -0.20),
        rng.uniform(0.07, 0.12),
        rng.uniform(-1e-3, 1e-3),
        rng.uniform(-1e-3, 1e-3),
        rng.uniform(-0.015, -0.005),
    ]
    return np.concatenate([core, np.round(coefficients, 6)])


def project(parameters, points):
    """Returns the pixels of points in the camera's frame, and which of them are really in the image."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = parameters
    z = np.maximum(points[:, 2], 1e-9)
    x, y = points[:, 0] / z, points[:, 1] / z
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + cx
    v = fy * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + cy
    pixels = np.stack([u, v], axis=1)
    limits = np.array(IMAGE_SIZE) - 1 - MARGIN_PX
    # Far outside the image the polynomial may fold back into it.
    seen = (points[:, 2] > 0.1) & (r2 < 2) & (pixels >= MARGIN_PX).all(axis=1) & (pixels <= limits).all(axis=1)
    return pixels, seen


def make_cameras(rng):
    """Returns the lenses and cam_from_rig. The cameras stand on a ring and look at one place before it."""
    cam_from_ring = []
    for camera in range(N_CAMERAS):
        angle = np.radians(225 + 90 * camera) + rng.normal(0, 0.03)
        radius = BASELINE_M / np.sqrt(2)
        centre = np.array([radius * np.cos(angle), radius * np.sin(angle), 0]) + rng.normal(0, 0.01, 3)
        forward = np.array([0, 0, 1.6]) + rng.normal(0, 0.05, 3) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross([0, 1, 0], forward)
        right /= np.linalg.norm(right)
        roll = rotation(np.array([0, 0, rng.normal(0, 0.05)]))
        turn = roll @ np.stack([right, np.cross(forward, right), forward])
        cam_from_ring.append((turn, -turn @ centre))
    first_turn, first_shift = cam_from_ring[0]
    poses = []
    for turn, shift in cam_from_ring:
        between = turn @ first_turn.T
        poses.append(pose(between, shift - between @ first_shift))
    return [lens(rng) for _ in range(N_CAMERAS)], poses, cam_from_ring[0]


def make_frame(rng, points, rig_from_ring):
    """Returns a random pose of the board in the volume that the cameras share."""
    tilt = rng.uniform(0, LARGEST_TILT_RAD)
    axis = rng.uniform(-np.pi, np.pi)
    turn = rotation(tilt * np.array([np.cos(axis), np.sin(axis), 0])) @ rotation(np.array([0, 0, rng.uniform(-0.8, 0.8)]))
    centre = np.array([rng.uniform(-1.15, 1.15), rng.uniform(-0.85, 0.85), rng.uniform(1.2, 2.0)])
    shift = centre - turn @ points.mean(axis=0)
    ring_turn, ring_shift = rig_from_ring
    return pose(ring_turn @ turn, ring_turn @ shift + ring_shift)


def usable(seen):
    """Says whether a partial board still has three rows and three columns, and twelve corners."""
    ids = np.flatnonzero(seen)
    return len(ids) >= 12 and len(set(ids // COLUMNS)) >= 3 and len(set(ids % COLUMNS)) >= 3


def main():
    if len(sys.argv) != 2:
        sys.exit("usage: make_rig4.py DIRECTORY")
    out = pathlib.Path(sys.argv[1])
    rng = np.random.default_rng(SEED)
    points = board()
    lenses, cam_from_rig, rig_from_ring = make_cameras(rng)

    rig_from_target, rows = [], []
    while len(rig_from_target) < N_FRAMES:
        candidate = make_frame(rng, points, rig_from_ring)
        views = [project(lenses[camera], transform(cam_from_rig[camera], transform(candidate, points))) for camera in range(N_CAMERAS)]
        noise = rng.normal(0, SIGMA_PX, (N_CAMERAS, len(points), 2))
        # What fewer than two cameras see says nothing about the rig.
        if sum(usable(seen) for _, seen in views) < 2:
            continue
        frame = len(rig_from_target)
        rig_from_target.append(candidate)
        for camera, (pixels, seen) in enumerate(views):
            if usable(seen):
                rows += [
                    (camera, frame, point, *(pixels[point] + noise[camera, point])) for point in np.flatnonzero(seen)
                ]

    out.mkdir(parents=True, exist_ok=True)
    with open(out / "corners.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow("camera,image,view,point,X,Y,Z,u,v".split(","))
        for camera, frame, point, u, v in sorted(rows, key=lambda row: row[:3]):
            place = (point % COLUMNS, point // COLUMNS, 0)
            writer.writerow((f"cam{camera}", f"cam{camera}-{frame:02}", frame, point, *place, f"{u:.4f}", f"{v:.4f}"))

    def pose_json(value):
        return {"rodrigues": value[:3].tolist(), "translation_m": value[3:].tolist()}

    truth = {
        "seed": SEED,
        "sigma_px": SIGMA_PX,
        "target": {"kind": "chessboard", "columns": COLUMNS, "rows": ROWS, "spacing_m": SPACING_M, "shape_m": list(SHAPE_M)},
        "cameras": [
            {
                "name": f"cam{camera}",
                "model": "opencv5",
                "image_size": list(IMAGE_SIZE),
                "params": dict(zip(PARAMETERS, lenses[camera].tolist())),
                "cam_from_rig": pose_json(cam_from_rig[camera]),
            }
            for camera in range(N_CAMERAS)
        ],
        "frames": [{"view": view, "rig_from_target": pose_json(value)} for view, value in enumerate(rig_from_target)],
    }
    with open(out / "truth.json", "w", encoding="utf-8") as file:
        json.dump(truth, file, indent=1, sort_keys=True)
        file.write("\n")


if __name__ == "__main__":
    main()
