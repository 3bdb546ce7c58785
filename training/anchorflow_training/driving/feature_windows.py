"""Windows with rasters of one's own, to train GoalFlow on: a folder with an .npz for each.

bev         [C, H, W], features of any meaning; row 0 farthest ahead, column 0 farthest left
extent      [4] m: least and greatest x, least and greatest y of the raster
ego         [8], the ego status: command, velocity, acceleration
trajectory  [T, 2 or 3] m, driven from the origin along x; its headings are the path's own
goal        [2] m; the trajectory's end if it is left out
size        [2] m, length and width of the car; that of nuPlan if it is left out
dt          s between poses; 0.5 if it is left out
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from anchorflow_driving.errors import UNREADABLE, LogError
from anchorflow_driving.geometry import arc_lengths, at_places
from anchorflow_driving.importers.navsim import EGO_SIZE
from anchorflow_driving.log import open_logs
from anchorflow_training.driving.windows import MOVED, SPACING

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Arrays = Mapping[str, NDArray[Any]]

FINE = 8  # points of a curve to one of the course
BEYOND_M = 10.0  # of a course, straight on from where the trajectory ends
SHAPES = {
    "bev": ("C", "H", "W"),
    "extent": (4,),
    "ego": (8,),
    "trajectory": ("T", "2 or 3"),
    "goal": (2,),
    "size": (2,),
    "dt": (),
}
OPTIONAL = ("goal", "size", "dt")
ABOVE_0 = ("size", "dt")
SAME_SHAPES, SAME_NUMBERS = ("bev", "trajectory"), ("extent", "dt")
"""What all windows have alike."""


@dataclass(frozen=True, eq=False)
class FeatureWindows:
    """W windows, whose rasters are read when they are asked for.

    status: [W, 8]; size: [W, 2] m; course, along, log: as `DrivingWindows`, each its own log
    goal: [W, 2] m; times: [T] s of the poses; layout: of the rasters, as `BevLayout`
    """

    files: Sequence[Path]
    status: Floats
    size: Floats
    course: Floats
    along: Floats
    goal: Floats
    log: NDArray[np.int64]
    times: NDArray[np.float64]
    layout: Mapping[str, Any]
    path: Path

    def __len__(self) -> int:
        return len(self.files)

    def rasters(self, windows: Iterable[int]) -> Floats:
        """[B, C, H, W] of these windows."""
        return np.stack([_read(self.files[w], ("bev",))["bev"] for w in windows]).astype(np.float32)


def has_features(folder: Path) -> bool:
    """Return whether the first .npz of a folder has a raster of features."""
    try:
        with np.load(open_logs(folder)[0], allow_pickle=False) as arrays:
            return "bev" in arrays
    except UNREADABLE:
        return False


def open_features(folder: Path) -> FeatureWindows:
    """Return the windows of a folder. Raises `LogError` if one lacks something or differs."""
    files = open_logs(folder)
    read: list[Arrays] = []
    first: Mapping[str, tuple[Any, ...]] = {}
    for file in files:
        arrays = _read(file, SHAPES)
        alike = {name: _alike(name, arrays[name]) for name in (*SAME_SHAPES, *SAME_NUMBERS)}
        first = first or alike
        for name, wanted in first.items():
            if alike[name] != wanted:
                expected = f"{wanted}, as {files[0].name}"
                raise LogError(file, name, expected=expected, found=f"{alike[name]}")
        del arrays["bev"]  # all of them may be more than the memory holds
        read.append(arrays)
    (dt,), (channels, rows, columns) = first["dt"], first["bev"]
    drives = [np.array(each["trajectory"][:, :2], np.float64) for each in read]
    longest = max(float(arc_lengths(np.concatenate([np.zeros((1, 2)), d]))[-1]) for d in drives)
    points = int((longest + BEYOND_M) / SPACING)
    courses, alongs = zip(*(_course(drive, points) for drive in drives), strict=True)
    return FeatureWindows(
        files=files,
        status=np.stack([each["ego"] for each in read]).astype(np.float32),
        size=np.stack([each["size"] for each in read]).astype(np.float32),
        course=np.stack(courses).astype(np.float32),
        along=np.stack(alongs).astype(np.float32),
        goal=np.stack([each["goal"] for each in read]).astype(np.float32),
        log=np.arange(len(files)),
        times=np.cumsum(np.full(len(drives[0]), float(dt))),
        layout={
            "channels": channels,
            "rows": rows,
            "columns": columns,
            "extent": tuple(float(edge) for edge in first["extent"]),
            "dtype": "float32",
        },
        path=folder,
    )


def _course(drive: Doubles, points: int) -> tuple[Doubles, Doubles]:
    """Return the course [P, 2] of a drive [T, 2] and how far along it the poses are, [T] m.

    Its places are SPACING apart along a spline through the drive, and straight on from there.
    """
    line = np.concatenate([np.zeros((1, 2)), drive])
    chords = np.linalg.norm(np.diff(line, axis=0), axis=1)
    moved = np.concatenate([[True], chords > MOVED])
    knots = np.concatenate([[0.0], np.cumsum(np.where(moved[1:], chords, 0.0))])
    last = np.array([1.0, 0.0])
    places, fine = line[:1], knots[:1]
    if moved.sum() > 1:
        curve = CubicSpline(knots[moved], line[moved], bc_type="natural")
        fine = np.union1d(np.linspace(0.0, knots[-1], FINE * points), knots)
        places, last = curve(fine), curve(knots[-1], 1)
    along = np.interp(knots[1:], fine, arc_lengths(places))
    beyond = places[-1] + 2 * points * SPACING * last / np.linalg.norm(last)
    places = np.concatenate([places, beyond[None]])
    return at_places(SPACING * np.arange(points), arc_lengths(places), places), along


def _alike(name: str, array: NDArray[Any]) -> tuple[Any, ...]:
    return array.shape if name in SAME_SHAPES else tuple(array.ravel().tolist())


def _read(file: Path, names: Iterable[str]) -> dict[str, NDArray[Any]]:
    """Return arrays of a window, with the usual ones for those that it may leave out."""
    try:
        with np.load(file, allow_pickle=False) as held:
            arrays = {name: held[name] for name in names if name in held}
    except UNREADABLE as error:
        raise LogError(file, "file", expected="an .npz of arrays", found=str(error)) from error
    for name in names:
        if name in arrays:
            _check(file, name, arrays[name])
        elif name not in OPTIONAL:
            raise LogError(file, name, expected=f"an array {_shape(name)}", found="none")
    if "trajectory" in arrays:
        usual = {"size": np.array(EGO_SIZE), "dt": np.array(0.5)}
        arrays = {"goal": arrays["trajectory"][-1, :2], **usual, **arrays}
    return arrays


def _check(file: Path, name: str, array: NDArray[Any]) -> None:
    shape = SHAPES[name]
    fits = array.ndim == len(shape) and all(
        axis in (size, "C", "H", "W", "T") or (axis == "2 or 3" and size in (2, 3))
        for axis, size in zip(shape, array.shape, strict=True)
    )
    if not fits or not array.size:
        raise LogError(file, name, expected=_shape(name), found=f"{[*array.shape]}")
    if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise LogError(file, name, expected="finite numbers", found=f"others, {array.dtype}")
    if name in ABOVE_0 and not (array > 0).all():
        raise LogError(file, name, expected="above 0", found=f"{array.tolist()}")
    if name == "extent" and not (array[0] < array[1] and array[2] < array[3]):
        expected = "the least x before the greatest, and of y"
        raise LogError(file, name, expected=expected, found=f"{array.tolist()}")


def _shape(name: str) -> str:
    return f"[{', '.join(map(str, SHAPES[name]))}]"
