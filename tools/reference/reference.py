#!/usr/bin/env python3
"""Writes datasets/opencv-stereo/reference with mrcal 2.2 and OpenCV 5.0.0, or checks it.

    reference.py [--check] [--venv DIR] [--out DIR]

The venv (target/refenv, or $BORESIGHT_REFENV) is created from requirements.txt when it is missing;
mrcal is the system's, because its Python module is a Debian package. `--check` writes nothing: it
makes the files in a temporary folder and compares their numbers with those in the repository.
Needs only the standard library. Exit: 0 good, 1 a number differs, 2 something is not installed.
"""

import argparse
import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
DATASET = ROOT / "datasets" / "opencv-stereo"
SYSTEM_PYTHON = "/usr/bin/python3"
MRCAL = "2.2"
TOLERANCE = 1e-6


def stop(message):
    print(f"reference.py: {message}", file=sys.stderr)
    sys.exit(2)


def requirements():
    lines = (HERE / "requirements.txt").read_text(encoding="utf-8").split()
    return dict(line.split("==") for line in lines)


def prepare_venv(folder):
    """Returns the Python of a venv that holds exactly what requirements.txt names."""
    python = folder / "bin" / "python"
    if not python.exists():
        print(f"creating {folder}", file=sys.stderr)
        if subprocess.run([sys.executable, "-m", "venv", str(folder)]).returncode:
            stop("cannot create a venv: apt-get install python3-venv")
    code = "import importlib.metadata as m, sys\nfor n in sys.argv[1:]:\n try: print(n, m.version(n))\n except m.PackageNotFoundError: pass"

    def missing():
        found = subprocess.run([python, "-c", code, *requirements()], capture_output=True, text=True, check=True).stdout
        found = dict(line.split() for line in found.splitlines())
        return [f"{name}=={version}" for name, version in requirements().items() if found.get(name) != version]

    if missing():
        install = [str(python), "-m", "pip", "install", "--quiet", "-r", str(HERE / "requirements.txt")]
        # pip may talk, but stdout is ours.
        if subprocess.run(install, stdout=sys.stderr).returncode or missing():
            stop(f"cannot install {' '.join(missing())}; try: {' '.join(install)}")
    return python


def mrcal_version():
    """Returns the installed mrcal's Debian version, after checking that it is the pinned release."""
    query = ["dpkg-query", "-W", "-f", "${Version}", "python3-mrcal"]
    try:
        version = subprocess.run(query, capture_output=True, text=True).stdout
    except FileNotFoundError:
        version = ""
    if not version:
        stop("mrcal is missing: apt-get install mrcal python3-mrcal (Debian 12)")
    if version.split("-")[0] != MRCAL:
        stop(f"mrcal is {version}, the references are made with {MRCAL} (Debian 12)")
    return version


def write(out, venv):
    version = mrcal_version()
    python = prepare_venv(venv)
    out.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    for command in (
        [python, HERE / "opencv_reference.py", DATASET, out],
        [SYSTEM_PYTHON, HERE / "mrcal_reference.py", DATASET, out, version],
    ):
        # What the tools say on the way is not the answer.
        if subprocess.run([str(part) for part in command], env=environment, stdout=sys.stderr).returncode:
            stop(f"{pathlib.Path(command[1]).name} failed")


def differences(mine, theirs, where):
    """Yields a line for everything in which two JSON values differ by more than the tolerance."""
    if isinstance(mine, dict) and isinstance(theirs, dict) and mine.keys() == theirs.keys():
        for key in sorted(mine):
            yield from differences(mine[key], theirs[key], f"{where}.{key}")
    elif isinstance(mine, list) and isinstance(theirs, list) and len(mine) == len(theirs):
        for number, pair in enumerate(zip(mine, theirs)):
            yield from differences(*pair, f"{where}[{number}]")
    elif isinstance(mine, float) and isinstance(theirs, float):
        if not math.isclose(mine, theirs, rel_tol=TOLERANCE, abs_tol=TOLERANCE):
            yield f"{where}: committed {mine!r}, now {theirs!r}"
    elif mine != theirs:
        yield f"{where}: committed {mine!r}, now {theirs!r}"


def check(committed, venv):
    with tempfile.TemporaryDirectory() as folder:
        fresh = pathlib.Path(folder)
        write(fresh, venv)
        lines = []
        names = {path.name for path in committed.glob("*")} | {path.name for path in fresh.glob("*")}
        for name in sorted(names):
            if not (committed / name).exists() or not (fresh / name).exists():
                lines.append(f"{name}: only {'made now' if (fresh / name).exists() else 'committed'}")
            elif name.endswith(".json"):
                values = [json.loads((place / name).read_text(encoding="utf-8")) for place in (committed, fresh)]
                lines += differences(*values, name)
    for line in lines:
        print(line)
    print(f"{len(names)} files, {len(lines)} differences")
    return 1 if lines else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--venv", type=pathlib.Path, default=os.environ.get("BORESIGHT_REFENV", ROOT / "target" / "refenv"))
    parser.add_argument("--out", type=pathlib.Path, default=DATASET / "reference")
    args = parser.parse_args()
    venv = pathlib.Path(args.venv)
    if args.check:
        return check(args.out, venv)
    write(args.out, venv)
    for path in sorted(args.out.iterdir()):
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
