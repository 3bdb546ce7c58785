"""ROS maps for the tests of the page: a drawing, its files, and how YAML may write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

YAML = """image: {image}
resolution: 0.1
origin: [-2.0, 1.5, 0.0]
negate: {negate}
occupied_thresh: 0.65
free_thresh: 0.196
mode: {mode}
"""
PLAIN = YAML.format(image="a.pgm", mode="trinary", negate=0)
WRITTEN = (
    PLAIN,
    PLAIN.replace("negate: 0", "negate: false"),
    PLAIN.replace("[-2.0, 1.5, 0.0]", "[-2.0,  # x\n  1.5,\n  0.0]"),
    PLAIN.replace("[-2.0, 1.5, 0.0]", "\n- -2.0\n- 1.5\n- 0"),
    PLAIN + "meta:\n  resolution: 0.5\n  mode: raw\n",
    "\ufeff---\n" + PLAIN.replace("a.pgm", '"a.pgm" # c').replace("\n", "\r\n"),
    PLAIN.replace("a.pgm", "./a.pgm"),
    PLAIN.replace("negate: 0", "negate: 1"),
    PLAIN.replace("trinary", "scale"),
    PLAIN.replace("trinary", "raw"),
    PLAIN.replace("0.65", "1.0").replace("0.196", "0.0"),
    PLAIN.replace("1.5, 0.0]", "1.5, -3.06e-17]"),
    PLAIN.replace("1.5, 0.0]", "1.5, 6.283185307179586]"),
    PLAIN.replace("resolution: 0.1", "resolution: 1e-1").replace("-2.0, 1.5", "-2e+00, 15e-1"),
    PLAIN.replace("resolution: 0.1", 'resolution: "0.1"').replace("negate: 0", 'negate: "0"'),
    PLAIN.replace("trinary", "Trinary"),
    PLAIN.replace("trinary", "scale").replace("0.65", "0.9").replace("0.196", "0.1"),
)
"""Ways to write the YAML file of one picture."""
REFUSED = (
    ("image: a.pgm", "image: 3"),
    ("mode: trinary", "mode: dual"),
    ("mode: trinary", "mode:"),
    ("0.65", "65"),
    ("0.196", "0.7"),
    ("0.196", "0.65"),
    ("negate: 0", "negate: 2"),
    ("resolution: 0.1", "resolution: 0.0000001"),
    ("resolution: 0.1", "resolution: 101"),
    ("resolution: 0.1", "resolution: true"),
    ("resolution: 0.1", "resolution: 1e"),
    ("resolution: 0.1\n", ""),
    ("[-2.0, 1.5, 0.0]", "[-2.0, 1.5]"),
    ("[-2.0, 1.5, 0.0]", "[.inf, 1.5, 0.0]"),
    ("[-2.0, 1.5, 0.0]", "[-2.0, 1.5, 0.1]"),
    ("[-2.0, 1.5, 0.0]", "[1.0e+8, 1.5, 0.0]"),
)
"""Changes of the plain YAML file that make it wrong."""


def drawing() -> np.ndarray:
    """[40, 50] grey levels, top row first; known at the edges, so that nothing is trimmed."""
    grey = np.full((40, 50), 254, np.uint8)
    grey[5:12, 10:30] = 0
    grey[20:24, 20:24] = 205  # between the thresholds: unknown
    grey[25:30, 5:9] = 60  # unknown in raw mode, occupied in the others
    grey[0, 0] = grey[0, -1] = grey[-1, 0] = grey[-1, -1] = 0
    return grey


def pgm(grey: np.ndarray, *, text: bool = False) -> bytes:
    """A PGM file, P5 or P2."""
    height, width = grey.shape
    head = f"{'P2' if text else 'P5'}\n# a comment\n{width} {height}\n255\n".encode()
    return head + (" ".join(map(str, grey.ravel())).encode() if text else grey.tobytes())


def map_files(
    folder: Path, name: str, picture: bytes, *, mode: str = "trinary", negate: int = 0
) -> list[Path]:
    """A YAML file and its picture."""
    (folder / name).write_bytes(picture)
    (folder / "map.yaml").write_text(YAML.format(image=name, mode=mode, negate=negate))
    return [folder / "map.yaml", folder / name]


def write_map(folder: Path, pixels: np.ndarray, origin: tuple[float, float] = (0.0, 0.0)) -> Path:
    """Write a map of grey levels [H, W], 0.1 m/cell, with its corner at [2] m; return its YAML."""
    path, _ = map_files(folder, "room.pgm", pgm(pixels))
    x, y = origin
    path.write_text(path.read_text().replace("[-2.0, 1.5, 0.0]", f"[{x}, {y}, 0.0]"))
    return path
