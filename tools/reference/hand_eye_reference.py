#!/usr/bin/env python3
"""Leaves out each frame of the recorded hand-eye sets in turn and foretells it with OpenCV's closed forms.

    hand_eye_reference.py SHARED_DATASETS TAG_CORNERS.csv

Prints JSON: for each set and method the mean, the 95th percentile and the largest distance in mm between a point and
where the ray of its pixel meets the board's plane. The lens comes from cv2.calibrateCamera on all frames, or from the
maker for the single tag. Needs an OpenCV that has calibrateHandEye (4.x; 5.0.0 lacks it) and numpy.
"""

import csv
import json
import pathlib
import re
import sys

import cv2
import numpy as np

HAND_EYE = ["TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS"]
ROBOT_WORLD = ["SHAH", "LI"]


def inverse(pose):
    result = np.eye(4)
    result[:3, :3] = pose[:3, :3].T
    result[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return result


def pose_of(rotation_vector, translation):
    result = np.eye(4)
    result[:3, :3] = cv2.Rodrigues(np.asarray(rotation_vector, float))[0]
    result[:3, 3] = np.ravel(translation)
    return result


def mean_pose(poses):
    u, _, vt = np.linalg.svd(sum(pose[:3, :3] for pose in poses))
    result = np.eye(4)
    result[:3, :3] = u @ vt
    result[:3, 3] = np.mean([pose[:3, 3] for pose in poses], axis=0)
    return result


def read_vnl(path):
    views = {}
    for line in open(path):
        fields = line.split()
        if line[0] != "#" and len(fields) > 2 and fields[1] != "-":
            views.setdefault(fields[0], []).append((float(fields[1]), float(fields[2])))
    return [np.array(views[name], np.float32) for name in sorted(views)]


def visp_poses(folder):
    poses = []
    for i in range(1, 9):
        numbers = re.findall(r"\[(.*?)\]", (folder / f"franka_pose_rPe_{i}.yaml").read_text())
        numbers = [float(number) for number in numbers]
        poses.append(pose_of(numbers[3:], numbers[:3]))
    return poses


def board(columns, rows, spacing):
    return np.array([[c * spacing, r * spacing, 0] for r in range(rows) for c in range(columns)], np.float32)


def distances(points, pixels, matrix, distortion, cam_from_target):
    rays = np.c_[cv2.undistortPoints(pixels.reshape(-1, 1, 2), matrix, distortion).reshape(-1, 2), np.ones(len(pixels))]
    in_cam = points @ cam_from_target[:3, :3].T + cam_from_target[:3, 3]
    normal = cam_from_target[:3, 2]
    return np.linalg.norm(rays * ((in_cam @ normal) / (rays @ normal))[:, None] - in_cam, axis=1)


def foretell(method, arms, sights, left_out):
    others = [i for i in range(len(arms)) if i != left_out]
    split = lambda poses: ([pose[:3, :3] for pose in poses], [pose[:3, 3] for pose in poses])
    seen = split([sights[i] for i in others])
    if method in HAND_EYE:
        code = getattr(cv2, f"CALIB_HAND_EYE_{method}")
        rotation, translation = cv2.calibrateHandEye(*split([arms[i] for i in others]), *seen, method=code)
        carrier_from_cam = np.eye(4)
        carrier_from_cam[:3, :3], carrier_from_cam[:3, 3] = rotation, translation.ravel()
        other_from_target = mean_pose([arms[i] @ carrier_from_cam @ sights[i] for i in others])
        return inverse(arms[left_out] @ carrier_from_cam) @ other_from_target
    code = getattr(cv2, f"CALIB_ROBOT_WORLD_HAND_EYE_{method}")
    found = cv2.calibrateRobotWorldHandEye(*seen, *split([inverse(arms[i]) for i in others]), method=code)
    base, cam = np.eye(4), np.eye(4)
    base[:3, :3], base[:3, 3] = found[0], found[1].ravel()
    cam[:3, :3], cam[:3, 3] = found[2], found[3].ravel()
    return cam @ inverse(arms[left_out]) @ inverse(base)


def measure(points, views, arms, matrix, distortion, sights):
    rows = {}
    for method in HAND_EYE + ROBOT_WORLD:
        errors = []
        for i, pixels in enumerate(views):
            errors.extend(1e3 * distances(points, pixels, matrix, distortion, foretell(method, arms, sights, i)))
        rows[method.lower()] = [float(np.mean(errors)), float(np.percentile(errors, 95)), float(np.max(errors))]
    return rows


def calibrated(points, views, size):
    found = cv2.calibrateCamera([points] * len(views), [view.reshape(-1, 1, 2) for view in views], size, None, None)
    _, matrix, distortion, rotations, translations = found
    return matrix, distortion, [pose_of(r, t) for r, t in zip(rotations, translations)]


def main(shared, tag_corners):
    shared = pathlib.Path(shared)
    result = {"opencv": cv2.__version__}
    points = board(28, 17, 0.02)
    views = read_vnl(shared / "handeye-kuka1-rwhe/derived/corners-opencv.vnl")
    lines = (shared / "handeye-kuka1-rwhe/raw/RobotPosesVec.txt").read_text().splitlines()
    arms = [np.array(line.split(), float).reshape(4, 4) for line in lines]
    result["handeye-kuka1"] = measure(points, views, arms, *calibrated(points, views, (1928, 1208)))

    franka = shared / "handeye-franka-visp"
    points = board(9, 6, 0.0236)
    views = read_vnl(franka / "derived/corners-opencv.vnl")
    arms = visp_poses(franka / "raw/eye-in-hand")
    result["handeye-franka-in-hand"] = measure(points, views, arms, *calibrated(points, views, (640, 480)))

    matrix = np.array([[607.5931396484375, 0, 323.46282958984375], [0, 607.574951171875, 243.2552947998047], [0, 0, 1]])
    points = np.array([[-0.024, -0.024, 0], [0.024, -0.024, 0], [0.024, 0.024, 0], [-0.024, 0.024, 0]])
    views = {}
    for row in csv.DictReader(open(tag_corners)):
        views.setdefault(row["view"], []).append((float(row["u"]), float(row["v"])))
    views = [np.array(views[name], np.float32) for name in sorted(views)]
    sights = [pose_of(*cv2.solvePnP(points, view, matrix, np.zeros(5))[1:]) for view in views]
    arms = [inverse(pose) for pose in visp_poses(franka / "raw/eye-to-hand")]
    result["handeye-franka-to-hand"] = measure(points, views, arms, matrix, np.zeros(5), sights)
    json.dump(result, sys.stdout, indent=1)


if __name__ == "__main__":
    main(*sys.argv[1:])
