#!/usr/bin/python3
"""Solves problems with their outliers by mrcal with rejection, and prints one line of JSON for each.

    /usr/bin/python3 mrcal_reject.py PROBLEM.npz... [--repeat N]

`cpu_s` is the least CPU time of mrcal.optimize() alone.
"""

import argparse
import json
import sys
import time

from mrcal_solve import arguments

import mrcal
import numpy as np


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problem", nargs="+")
    parser.add_argument("--repeat", type=int, default=3)
    args = parser.parse_args()
    for path in args.problem:
        with np.load(path) as stored:
            problem = {key: stored[key] for key in stored.files}
        seconds = []
        for _ in range(args.repeat):
            state = arguments(problem)
            flat = state["observations_board"].reshape(-1, 3)
            flat[problem["outlier_flat_index"], :2] += problem["outlier_dq"]
            state["do_apply_outlier_rejection"] = True
            start = time.process_time()
            mrcal.optimize(**state)
            seconds.append(time.process_time() - start)
        rejected = set(np.nonzero(state["observations_board"].reshape(-1, 3)[:, 2] <= 0)[0])
        moved = set(problem["outlier_flat_index"])
        answer = {
            "tool": "mrcal",
            "problem": path,
            "cpu_s": min(seconds),
            "cpu_s_each": seconds,
            "outliers": len(moved),
            "missed_of_all": len(moved - rejected),
            "good_lost": len(rejected - moved),
        }
        print(json.dumps(answer))
        sys.stdout.flush()


if __name__ == "__main__":
    main()
