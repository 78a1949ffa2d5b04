#!/usr/bin/env python3
"""Makes calibration problems for the benchmark, and turns them into the Ceres program's binary.

    make_problem.py convert PROBLEM.npz OUT.bin
    make_problem.py make OUT.npz --cameras 4 --frames 500 [--board 10] [--seed 1] [--knots 30 18 120]
    make_problem.py pack ARRAYS.json OUT.npz

The npz keys are those of the mrcal conformance problems (see README.md); the binary is described at
the head of ceres/ba.cpp; `pack` takes what tests/examples/make_problem.rs prints. Needs numpy only.
"""

import argparse
import json
import struct
import sys

try:
    import numpy as np
except ImportError:
    sys.exit("make_problem.py: numpy is missing: apt-get install python3-numpy (or pip install numpy)")


def rotation(rodrigues):
    """Returns the rotation matrix of a Rodrigues vector."""
    angle = np.linalg.norm(rodrigues)
    x, y, z = rodrigues
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    if angle < 1e-9:
        return np.eye(3) + cross
    return np.eye(3) + np.sin(angle) / angle * cross + (1 - np.cos(angle)) / angle**2 * cross @ cross


def rodrigues_of(matrix):
    """Returns the Rodrigues vector of a rotation matrix whose angle is well below pi."""
    axis = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]) / 2
    sine = np.linalg.norm(axis)
    if sine < 1e-12:
        return axis
    return axis / sine * np.arctan2(sine, (np.trace(matrix) - 1) / 2)


def board_points(width, height, spacing, warp):
    """Returns the corners of the bent board, [height, width, 3]."""
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    xr, yr = column / (width - 1), row / (height - 1)
    z = warp[0] * 4 * xr * (1 - xr) + warp[1] * 4 * yr * (1 - yr)
    return np.stack([column * spacing, row * spacing, z], axis=-1)


def project(points, intrinsics):
    """Projects points with the eight-coefficient OpenCV lens."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6 = intrinsics
    x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    u = fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + cx
    v = fy * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + cy
    return np.stack([u, v], axis=-1)


def make(n_cameras, n_frames, n_corners, seed, knots):
    """Returns a random problem: a row of cameras 0.3 m apart, and a board that wanders before them.

    With `knots` (columns, rows, degrees across) a spline of order 3 is to be found instead of the lens that
    made the pixels, from a flat surface.
    """
    rng = np.random.default_rng(seed)
    width, height, spacing = 4000, 2200, 0.1
    warp = np.array([0.002, -0.003])
    board = board_points(n_corners, n_corners, spacing, warp)
    middle = np.array([(n_corners - 1) / 2 * spacing, (n_corners - 1) / 2 * spacing, 0.0])

    typical = np.array([1760, 1760, 1960, 1070, -0.012, 0.035, -3e-4, 5e-4, 0.02, 0.014, -0.052, 0.05])
    spread = np.array([10, 10, 30, 20, 2e-3, 2e-3, 5e-5, 5e-5, 2e-3, 2e-3, 2e-3, 2e-3])
    intrinsics = typical + spread * rng.standard_normal((n_cameras, 12))
    intrinsics[:, 1] = intrinsics[:, 0] + 0.05 * rng.standard_normal(n_cameras)
    extrinsics = np.zeros((n_cameras - 1, 6))
    for camera in range(1, n_cameras):
        turn = rotation(rng.normal(0, 0.03, 3))
        position = np.array([0.3 * camera, 0, 0]) + rng.normal(0, 0.01, 3)
        extrinsics[camera - 1] = [*rodrigues_of(turn), *(-turn @ position)]

    frames, index, observations = [], [], []
    while len(frames) < n_frames:
        turn = rotation(rng.uniform(-0.6, 0.6, 3) * [1, 1, 0.5])
        rig_middle = 0.15 * (n_cameras - 1)
        centre = np.array([rig_middle + rng.uniform(-1.2, 1.2), rng.uniform(-0.6, 0.6), rng.uniform(1.2, 3.0)])
        frame = np.array([*rodrigues_of(turn), *(centre - turn @ middle)])
        in_ref = board @ turn.T + frame[3:]
        views = []
        for camera in range(n_cameras):
            in_cam = in_ref
            if camera:
                in_cam = in_ref @ rotation(extrinsics[camera - 1, :3]).T + extrinsics[camera - 1, 3:]
            if in_cam[..., 2].min() < 0.2:
                continue
            pixels = project(in_cam, intrinsics[camera])
            if pixels.min() < 0 or pixels[..., 0].max() > width - 1 or pixels[..., 1].max() > height - 1:
                continue
            pixels = pixels + rng.normal(0, 0.3, pixels.shape)
            views.append((camera, np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)))
        # A frame that fewer than two cameras share ties nothing together in a rig.
        if len(views) < min(2, n_cameras):
            continue
        for camera, seen in views:
            index.append([len(frames), camera, camera - 1])
            observations.append(seen)
        frames.append(frame)

    frames = np.array(frames)
    seed_intrinsics = np.zeros_like(intrinsics)
    seed_intrinsics[:, :4] = [1700, 1700, (width - 1) / 2, (height - 1) / 2]
    lens = "LENSMODEL_OPENCV8"
    if knots:
        columns, rows, degrees = knots
        lens = f"LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx={columns}_Ny={rows}_fov_x_deg={degrees}"
        seed_intrinsics = np.pad(seed_intrinsics[:, :4], ((0, 0), (0, 2 * columns * rows)))
    return {
        "lensmodel": lens,
        "lensmodel_true": "LENSMODEL_OPENCV8",
        "imagersizes": np.tile(np.array([width, height], np.int32), (n_cameras, 1)),
        "spacing": spacing,
        "board_wh": np.array([n_corners, n_corners]),
        "observations": np.array(observations),
        "indices_frame_camintrinsics_camextrinsics": np.array(index, np.int32),
        "intrinsics_seed": seed_intrinsics,
        "extrinsics_rt_fromref_seed": extrinsics + rng.normal(0, 0.005, extrinsics.shape),
        "frames_rt_toref_seed": frames + rng.normal(0, 0.01, frames.shape),
        "calobject_warp_seed": np.zeros(2),
        "intrinsics_true": intrinsics,
        "extrinsics_rt_fromref_true": extrinsics,
        "frames_rt_toref_true": frames,
        "calobject_warp_true": warp,
        "noise_sigma": 0.3,
        "rng_seed": seed,
    }


def pack(arrays):
    """Returns a problem from its arrays as lists."""
    corners, (width, height) = np.array(arrays["observations"]), arrays["board_wh"]
    return {
        **arrays,
        "imagersizes": np.array(arrays["imagersizes"], np.int32),
        "observations": corners.reshape(len(corners), height, width, 3),
        "indices_frame_camintrinsics_camextrinsics": np.array(
            arrays["indices_frame_camintrinsics_camextrinsics"], np.int32
        ),
        "extrinsics_rt_fromref_seed": np.array(arrays["extrinsics_rt_fromref_seed"]).reshape(-1, 6),
        "extrinsics_rt_fromref_true": np.array(arrays["extrinsics_rt_fromref_true"]).reshape(-1, 6),
    }


def convert(problem, path):
    """Writes a problem in the layout of ceres/ba.cpp."""
    if str(problem["lensmodel"]) != "LENSMODEL_OPENCV8":
        sys.exit(f"make_problem.py: only LENSMODEL_OPENCV8 can be converted, this is {problem['lensmodel']}")
    observations = problem["observations"]
    index = problem["indices_frame_camintrinsics_camextrinsics"]
    n_views, height, width, _ = observations.shape
    counts = (
        len(problem["intrinsics_seed"]),
        len(problem["extrinsics_rt_fromref_seed"]),
        len(problem["frames_rt_toref_seed"]),
        n_views,
        width,
        height,
    )
    with open(path, "wb") as out:
        out.write(b"BSBA0001" + struct.pack("<6Id", *counts, float(problem["spacing"])))
        for array in (problem["imagersizes"], index):
            out.write(np.ascontiguousarray(array, "<i4").tobytes())
        for key in (
            "intrinsics_seed",
            "extrinsics_rt_fromref_seed",
            "frames_rt_toref_seed",
            "calobject_warp_seed",
            "observations",
        ):
            out.write(np.ascontiguousarray(problem[key], "<f8").tobytes())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    command = commands.add_parser("convert", help="npz to the Ceres program's binary")
    command.add_argument("problem")
    command.add_argument("out")
    command = commands.add_parser("make", help="a new random problem as npz")
    command.add_argument("out")
    command.add_argument("--cameras", type=int, required=True)
    command.add_argument("--frames", type=int, required=True)
    command.add_argument("--board", type=int, default=10, help="inner corners along each side")
    command.add_argument("--seed", type=int, default=1)
    command.add_argument("--knots", type=int, nargs=3, help="columns, rows, degrees: a splined lens to be found")
    command = commands.add_parser("pack", help="arrays in JSON, as synthetic's, to npz")
    command.add_argument("arrays")
    command.add_argument("out")
    args = parser.parse_args()
    if args.command == "pack":
        with open(args.arrays, encoding="utf-8") as arrays:
            np.savez_compressed(args.out, **pack(json.load(arrays)))
    elif args.command == "convert":
        with np.load(args.problem) as problem:
            convert(problem, args.out)
    else:
        np.savez_compressed(args.out, **make(args.cameras, args.frames, args.board, args.seed, args.knots))


if __name__ == "__main__":
    main()
