"""Writes crates/data/src/markers.txt: the bits of the marker dictionaries that boards are printed with.

The bits are facts of the printed boards. They are taken from the dictionaries that OpenCV (Apache-2.0) predefines;
those of AprilTag are its families as OpenCV draws them. The smaller dictionaries of a size are the beginnings of the
largest one, which is checked here.

    /opt/refenv/bin/python tools/reference/markers.py
"""

import pathlib

import cv2

TABLES = {
    "4x4": "DICT_4X4_1000",
    "5x5": "DICT_5X5_1000",
    "6x6": "DICT_6X6_1000",
    "7x7": "DICT_7X7_1000",
    "original": "DICT_ARUCO_ORIGINAL",
    "16h5": "DICT_APRILTAG_16h5",
    "25h9": "DICT_APRILTAG_25h9",
    "36h11": "DICT_APRILTAG_36h11",
}

PER_LINE = 12


def codes(name):
    """Returns the codes of a dictionary: row by row from the top left, the first bit the highest, 1 is white."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    side = dictionary.markerSize
    found = []
    for i in range(dictionary.bytesList.shape[0]):
        bits = cv2.aruco.Dictionary.getBitsFromByteList(dictionary.bytesList[i : i + 1], side)
        found.append(int("".join(str(int(bit)) for bit in bits.ravel()), 2))
    return side, found


def main():
    lines = [
        f"# Bits of marker dictionaries, made by tools/reference/markers.py from OpenCV {cv2.__version__} (Apache-2.0).",
        "# A line with a name and the bits along a side, then a code per marker in hexadecimal: row by row from the top",
        "# left, the first bit the highest, 1 is white.",
    ]
    for name, opencv in TABLES.items():
        side, table = codes(opencv)
        for shorter in (50, 100, 250) if opencv.endswith("_1000") else ():
            assert codes(opencv.replace("1000", str(shorter)))[1] == table[:shorter], (name, shorter)
        lines.append(f"{name} {side}")
        words = [f"{code:x}" for code in table]
        lines += [" ".join(words[i : i + PER_LINE]) for i in range(0, len(words), PER_LINE)]
    path = pathlib.Path(__file__).resolve().parents[2] / "crates/data/src/markers.txt"
    path.write_text("\n".join(lines) + "\n")
    print(f"{path}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
