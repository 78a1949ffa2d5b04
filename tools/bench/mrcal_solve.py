#!/usr/bin/python3
"""Solves one problem with mrcal and prints one line of JSON.

    /usr/bin/python3 mrcal_solve.py PROBLEM.npz [--repeat N] [--solution OUT.npz] [--count]

Regularisation is on, outlier rejection off, everything but the core of a splined lens is estimated. `cpu_s` is the CPU time of
mrcal.optimize() alone: neither the import nor the loading is in it. `--count` adds the number of
evaluations, from one more, untimed solve. mrcal's Python module belongs to the system's Python.
"""

import argparse
import json
import os
import resource
import statistics
import sys
import tempfile
import time

# mrcal does not use them, but no library underneath may start threads of its own.
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[variable] = "1"

try:
    import mrcal
    import numpy as np
except ImportError as error:
    sys.exit(
        f"mrcal_solve.py: {error.name} is missing: apt-get install mrcal python3-mrcal, then run with /usr/bin/python3"
    )


def version():
    """Returns mrcal's Debian version. The module does not know its own."""
    path = "/var/lib/dpkg/status"
    if os.path.exists(path):
        with open(path, encoding="utf-8") as status:
            for package in status.read().split("\n\n"):
                if package.startswith("Package: python3-mrcal\n"):
                    return next(line[9:] for line in package.splitlines() if line.startswith("Version: "))
    return "unknown"


def arguments(problem):
    """Returns fresh arguments for mrcal.optimize(), which overwrites the arrays it is given."""

    def copy(key, kind=float):
        return np.array(problem[key], dtype=kind, order="C")

    return {
        "intrinsics": copy("intrinsics_seed"),
        "extrinsics_rt_fromref": copy("extrinsics_rt_fromref_seed"),
        "frames_rt_toref": copy("frames_rt_toref_seed"),
        "points": None,
        "observations_board": copy("observations"),
        "indices_frame_camintrinsics_camextrinsics": copy("indices_frame_camintrinsics_camextrinsics", np.int32),
        "observations_point": None,
        "indices_point_camintrinsics_camextrinsics": None,
        "lensmodel": str(problem["lensmodel"]),
        "imagersizes": copy("imagersizes", np.int32),
        "calobject_warp": copy("calobject_warp_seed"),
        "calibration_object_spacing": float(problem["spacing"]),
        "do_apply_regularization": True,
        "do_apply_outlier_rejection": False,
        # The core of a splined lens is held, as mrcal-calibrate-cameras does: its knots can say the same.
        "do_optimize_intrinsics_core": "SPLINED" not in str(problem["lensmodel"]),
        "verbose": False,
    }


def count_evaluations(problem):
    """Returns how often mrcal evaluated its measurements, read off the log of a verbose solve."""
    sys.stdout.flush()
    saved = [os.dup(stream) for stream in (1, 2)]
    with tempfile.TemporaryFile() as log:
        for stream in (1, 2):
            os.dup2(log.fileno(), stream)
        try:
            mrcal.optimize(**{**arguments(problem), "verbose": True})
        finally:
            for stream, copy in zip((1, 2), saved):
                os.dup2(copy, stream)
                os.close(copy)
        log.seek(0)
        lines = log.read().decode(errors="replace").splitlines()
    # A log line is one trial step; the fourth column is the cost behind it, "-" where the step was
    # so small that it was not evaluated any more. The start is evaluated once.
    trials = [line.split() for line in lines if line[:1].isdigit()]
    return 1 + sum(1 for trial in trials if len(trial) > 3 and trial[3] != "-")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problem")
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--solution")
    parser.add_argument("--count", action="store_true")
    args = parser.parse_args()
    with np.load(args.problem) as stored:
        problem = {key: stored[key] for key in stored.files}

    seconds = []
    for _ in range(args.repeat):
        state = arguments(problem)
        start = time.process_time()
        stats = mrcal.optimize(**state)
        seconds.append(time.process_time() - start)
    residuals = stats["x"]
    answer = {
        "tool": "mrcal",
        "version": version(),
        "cpu_s": statistics.median(seconds),
        "cpu_s_each": seconds,
        "cost": float(residuals @ residuals),
        "peak_rss_kb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
        "problem": "same",
    }
    if args.count:
        answer["evaluations"] = count_evaluations(problem)
    if args.solution:
        keys = ("intrinsics", "extrinsics_rt_fromref", "frames_rt_toref", "calobject_warp")
        np.savez(args.solution, cost=answer["cost"], **{key: state[key] for key in keys})
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
