#!/usr/bin/env python3
"""Runs OpenCV's solvers of three points on random triangles, frontal to 80 degrees, and counts what they find.

    p3p_opencv.py [COUNT]

The views are drawn like those of the test `a_million_poses` of crates/seed: corners in a square of 2 m, 2 to
10 m away, up to half the distance aside. A pose counts as found if the worst of the three points is within
1e-6 of its distance from where it is, and a solution as false if it misses a ray or a side by as much.
"""

import sys
import time

try:
    import cv2
    import numpy as np
except ImportError:
    sys.exit("p3p_opencv.py: OpenCV is missing; use the venv of reference.py")


def views(count, rng):
    """Yields triangles in their own frame and in the camera's."""
    for i in range(count):
        while True:
            tilt = np.radians(80) * i / count
            points = np.column_stack([rng.uniform(-1, 1, (3, 2)), np.zeros(3)])
            turn, _ = cv2.Rodrigues(np.array([0, 0, 3.1 * rng.uniform(-1, 1)]))
            axis = 3.2 * rng.uniform(-1, 1)
            lean, _ = cv2.Rodrigues(tilt * np.array([np.cos(axis), np.sin(axis), 0]))
            depth = 6 + 4 * rng.uniform(-1, 1)
            place = depth * np.array([0.5 * rng.uniform(-1, 1), 0.4 * rng.uniform(-1, 1), 1])
            seen = points @ (lean @ turn).T + place
            if (seen[:, 2] > 0.05).all():
                yield points, seen
                break


def main():
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    for name, flag in [("SOLVEPNP_P3P", cv2.SOLVEPNP_P3P), ("SOLVEPNP_AP3P", cv2.SOLVEPNP_AP3P)]:
        lost, false, errors, seconds = 0, 0, [], 0.0
        for points, seen in views(count, np.random.default_rng(7)):
            pixels = (seen[:, :2] / seen[:, 2:]).reshape(3, 1, 2)
            begin = time.perf_counter()
            _, rotations, translations = cv2.solveP3P(points.reshape(3, 1, 3), pixels, np.eye(3), None, flags=flag)
            seconds += time.perf_counter() - begin
            best = np.inf
            for rotation, translation in zip(rotations, translations):
                matrix, _ = cv2.Rodrigues(rotation)
                found = points @ matrix.T + translation.ravel()
                distance = np.linalg.norm(seen, axis=1)
                best = min(best, (np.linalg.norm(found - seen, axis=1) / distance).max())
                rays = found / np.linalg.norm(found, axis=1)[:, None] - seen / distance[:, None]
                false += not np.abs(rays).max() < 1e-6
            lost += not best < 1e-6
            errors.append(best)
        print(f"{name}: {count} views, true pose lost {lost}, false solutions {false}, "
              f"median error {np.median(errors):.1e}, {1e6 * seconds / count:.1f} us each (from Python)")


if __name__ == "__main__":
    main()
