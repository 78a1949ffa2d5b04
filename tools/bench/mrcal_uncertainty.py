#!/usr/bin/python3
"""Works out mrcal's uncertainty map of one camera of a problem and prints one line of JSON.

    /usr/bin/python3 mrcal_uncertainty.py PROBLEM.npz CAMERA DISTANCE_M [--repeat N]

The problem is solved first, which does not count. `cpu_s` is the CPU time of unprojecting the 60x40 grid
and of mrcal.projection_uncertainty(), for observations with one pixel of noise; `inf` is infinity.
"""

import argparse
import json
import os
import statistics
import sys
import time

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[variable] = "1"

try:
    import mrcal
    import numpy as np
except ImportError as error:
    sys.exit(f"mrcal_uncertainty.py: {error.name} is missing: apt-get install mrcal python3-mrcal")

from mrcal_solve import arguments, version

COLUMNS, ROWS = 60, 40


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problem")
    parser.add_argument("camera", type=int)
    parser.add_argument("distance_m", type=float)
    parser.add_argument("--repeat", type=int, default=1)
    args = parser.parse_args()
    with np.load(args.problem) as stored:
        problem = {key: stored[key] for key in stored.files}
    state = arguments(problem)
    # What a solve leaves unsaid, the uncertainty wants to be told.
    for what in ("intrinsics_core", "intrinsics_distortions", "extrinsics", "frames", "calobject_warp"):
        state[f"do_optimize_{what}"] = True
    mrcal.optimize(**state)
    width, height = (int(side) for side in state["imagersizes"][args.camera])
    model = mrcal.cameramodel(optimization_inputs=state, icam_intrinsics=args.camera)
    across, down = np.linspace(0, width - 1, COLUMNS), np.linspace(0, height - 1, ROWS)
    pixels = np.ascontiguousarray(np.stack(np.meshgrid(across, down), axis=-1))
    is_far = np.isinf(args.distance_m)
    seconds = []
    for _ in range(args.repeat):
        start = time.process_time()
        points = mrcal.unproject(pixels, *model.intrinsics(), normalize=True)
        worst = mrcal.projection_uncertainty(
            points if is_far else points * args.distance_m,
            model,
            atinfinity=bool(is_far),
            what="worstdirection-stdev",
            observed_pixel_uncertainty=1.0,
        )
        seconds.append(time.process_time() - start)
    answer = {
        "tool": "mrcal",
        "version": version(),
        "cpu_s": statistics.median(seconds),
        "worst_px": [float(px) for px in worst.ravel()],
    }
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
