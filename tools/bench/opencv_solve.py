#!/usr/bin/env python3
"""Solves one problem with OpenCV and prints one line of JSON.

    opencv_solve.py PROBLEM.npz [--repeat N] [--frames N]

One camera: calibrateCamera; two cameras: stereoCalibrate, after each camera was calibrated alone
(those calibrations are timed with it). Both with the rational model. More cameras are answered with
`cpu_s: null`. This is a different problem from that of the other peers: OpenCV knows neither the
board's warp nor regularisation, stores corners as float32 and finds its own start, so the cost
cannot be compared. `--frames` keeps the first N frames: stereoCalibrate grows with their third power.
"""

import argparse
import json
import os
import resource
import statistics
import sys
import time

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[variable] = "1"

try:
    import cv2
    import numpy as np
except ImportError as error:
    sys.exit(f"opencv_solve.py: {error.name} is missing: pip install -r tools/reference/requirements.txt (in a venv)")

# Debian's Python may have its own, older OpenCV, which solves these problems with another algorithm.
if cv2.__version__ != "5.0.0":
    sys.exit(f"opencv_solve.py: OpenCV is {cv2.__version__}, 5.0.0 is needed: pip install -r tools/reference/requirements.txt (in a venv)")

NOTE = "different problem: no warp, no regularisation"
CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 1000, 1e-12)


def solve_mono(board, views, size):
    """Returns the sum of squares and the intrinsics of one camera."""
    rms, matrix, distortion, _, _ = cv2.calibrateCamera(
        [board] * len(views), views, size, None, None, flags=cv2.CALIB_RATIONAL_MODEL, criteria=CRITERIA
    )
    return rms**2 * len(views) * len(board), matrix, distortion


def solve_stereo(board, pairs, sizes):
    """Returns the sum of squares of a pair of cameras, with their intrinsics refined jointly."""
    views = [[pair[camera] for pair in pairs] for camera in (0, 1)]
    alone = [solve_mono(board, views[camera], sizes[camera]) for camera in (0, 1)]
    rms = cv2.stereoCalibrate(
        [board] * len(pairs),
        *views,
        *alone[0][1:],
        *alone[1][1:],
        sizes[0],
        flags=cv2.CALIB_RATIONAL_MODEL | cv2.CALIB_USE_INTRINSIC_GUESS,
        criteria=CRITERIA,
    )[0]
    return rms**2 * 2 * len(pairs) * len(board)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problem")
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--frames", type=int)
    args = parser.parse_args()
    cv2.setNumThreads(1)

    with np.load(args.problem) as problem:
        observations = problem["observations"]
        index = problem["indices_frame_camintrinsics_camextrinsics"]
        sizes = [tuple(int(n) for n in size) for size in problem["imagersizes"]]
        spacing = float(problem["spacing"])
    n_views, height, width, _ = observations.shape
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    board = np.stack([column * spacing, row * spacing, 0 * column], axis=-1).reshape(-1, 3).astype(np.float32)

    by_frame = {}
    for view, (frame, camera, _) in enumerate(index):
        pixels = np.ascontiguousarray(observations[view, ..., :2], np.float32).reshape(-1, 1, 2)
        by_frame.setdefault(int(frame), {})[int(camera)] = pixels
    frames = [by_frame[frame] for frame in sorted(by_frame)][: args.frames]

    answer = {"tool": "opencv", "version": cv2.__version__, "problem": NOTE}
    if len(sizes) == 1:
        views = [frame[0] for frame in frames]
        answer.update(call="calibrateCamera", frames=len(views))

        def solve():
            return solve_mono(board, views, sizes[0])[0]

    elif len(sizes) == 2:
        # A pair needs both cameras to see the whole board.
        pairs = [frame for frame in frames if len(frame) == 2]
        answer.update(call="stereoCalibrate", frames=len(pairs))

        def solve():
            return solve_stereo(board, pairs, sizes)

    else:
        answer.update(cpu_s=None, cost=None, problem="not applicable: OpenCV solves no rig of more than two cameras jointly")
        print(json.dumps(answer))
        return

    seconds = []
    for _ in range(args.repeat):
        start = time.process_time()
        cost = solve()
        seconds.append(time.process_time() - start)
    answer.update(
        cpu_s=statistics.median(seconds),
        cpu_s_each=seconds,
        cost=cost,
        peak_rss_kb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    )
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
