"""Argoverse 2 motion forecasting (Wilson et al., 2021): a parquet of tracks and a map in JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow  # pyright: ignore[reportMissingImports] - an extra that not every venv has
import pyarrow.parquet  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray

from anchorflow_driving.contours import union_rings
from anchorflow_driving.errors import LogError
from anchorflow_driving.geometry import Array, arc_lengths, at_places
from anchorflow_driving.importers.fields import Entry
from anchorflow_driving.importers.recording import Track, recorded_log
from anchorflow_driving.log import (
    CYCLIST,
    FRAME_S,
    PEDESTRIAN,
    STATIC,
    VEHICLE,
    DrivingLog,
    Lane,
    RoadMap,
)

EGO = "AV"
"""Track of the recording vehicle."""
EGO_SIZE = (4.87, 1.85)
"""Length and width of the recording Ford Fusion, m."""
# Motion forecasting records no boxes: kind, and a usual length and width, m.
KINDS = {
    "vehicle": (VEHICLE, (4.6, 1.9)),
    "bus": (VEHICLE, (12.0, 2.6)),
    "pedestrian": (PEDESTRIAN, (0.6, 0.6)),
    "cyclist": (CYCLIST, (1.8, 0.6)),
    "motorcyclist": (CYCLIST, (2.1, 0.8)),
    "riderless_bicycle": (STATIC, (1.8, 0.6)),
    "static": (STATIC, (0.6, 0.6)),
    "construction": (STATIC, (0.6, 0.6)),
    "background": (STATIC, (0.6, 0.6)),
    "unknown": (STATIC, (0.6, 0.6)),
}
TEXTS = ("scenario_id", "track_id", "object_type", "city")
NUMBERS = ("timestep", "position_x", "position_y", "heading", "velocity_x", "velocity_y")
NOT_DRIVEN = {"BIKE"}


def import_argoverse(path: Path) -> tuple[DrivingLog, Counter[str]]:
    """The log of a scenario, with every window whose recorded future is good, and what was counted.

    Boxes have the usual size of their type (`KINDS`), not their own.

    path: `scenario_*.parquet`, beside its `log_map_archive_*.json`, or the folder of the two

    Raises `LogError`.
    """
    file = _only(path, "scenario_*.parquet") if path.is_dir() else path
    columns = _columns(file)
    tracks = list(_tracks(file, columns))
    counts: Counter[str] = Counter()
    return recorded_log(
        tracks,
        _road(Entry.of_json(_only(file.parent, "log_map_archive_*.json")), counts),
        name=str(columns["scenario_id"][0]),
        source="av2",
        licence="CC BY-NC-SA 4.0, Argoverse 2",
        city=str(columns["city"][0]),
        path=file,
        origin=tracks[0].poses[0, :2],
    )


def _only(folder: Path, pattern: str) -> Path:
    found = sorted(folder.glob(pattern))
    if len(found) != 1:
        names = ", ".join(file.name for file in found) or "none"
        raise LogError(folder, "folder", expected=f"one {pattern}", found=names)
    return found[0]


def _columns(path: Path) -> dict[str, NDArray]:
    """Checked columns [rows]."""
    try:
        table = pyarrow.parquet.read_table(path)
    except (OSError, pyarrow.ArrowException) as error:
        raise LogError(path, "file", expected="a parquet file", found=str(error)) from error
    columns = {}
    for name in (*TEXTS, *NUMBERS):
        if name not in table.column_names:
            raise LogError(path, name, expected="the column", found="none")
        column = np.array(table.column(name).to_pylist())
        if name in TEXTS:
            fits, expected = column.dtype.kind == "U", "texts"
        else:
            fits = column.dtype.kind in "iuf" and bool(np.isfinite(column).all())
            expected = "finite numbers"
        if not fits or not len(column):
            found = f"{len(column)} values of {table.column(name).type}"
            raise LogError(path, name, expected=expected, found=found)
        columns[name] = column
    return columns


def _tracks(path: Path, columns: dict[str, NDArray]) -> Iterator[Track]:
    """The recording vehicle's first."""
    names, of_row = np.unique(columns["track_id"], return_inverse=True)
    if EGO not in names:
        raise LogError(path, "track_id", expected=f"{EGO}, the recording vehicle", found="none")
    for index in sorted(range(len(names)), key=lambda index: names[index] != EGO):
        rows = np.flatnonzero(of_row == index)
        rows = rows[np.argsort(columns["timestep"][rows], kind="stable")]
        step = columns["timestep"][rows].astype(np.float64)
        if step[0] < 0 or (np.diff(step) <= 0).any():
            field = f"timestep of track {names[index]}"
            raise LogError(path, field, expected="each once, from 0", found=str(step.tolist()))
        kind = str(columns["object_type"][rows[0]])
        if kind not in KINDS:
            field = f"object_type of track {names[index]}"
            raise LogError(path, field, expected=f"one of {', '.join(KINDS)}", found=kind)
        x, y, heading, vx, vy = (columns[name][rows] for name in NUMBERS[1:])
        yield Track(
            KINDS[kind][0],
            EGO_SIZE if names[index] == EGO else KINDS[kind][1],
            step * FRAME_S,
            np.stack([x, y, heading], -1).astype(np.float64),
            np.stack([vx, vy], -1).astype(np.float64),
        )


def _road(archive: Entry, counts: Counter[str]) -> RoadMap:
    lanes, lines = [], []
    for segment in archive["lane_segments"].values():
        sides = {side: _points(segment[f"{side}_lane_boundary"]) for side in ("left", "right")}
        for side, points in sides.items():
            paint = segment[f"{side}_lane_mark_type"].text
            if paint not in ("NONE", "UNKNOWN"):
                lines.append((points, "SOLID" in paint))
        if segment["lane_type"].text in NOT_DRIVEN:
            counts["dropped: lane for bicycles"] += 1
            continue
        lanes.append(
            Lane(
                name=segment["id"].text,
                polygon=np.concatenate([sides["right"], sides["left"][::-1]]),
                centre=_between(sides["left"], sides["right"]),
                successors=segment["successors"].texts,
                in_junction=segment["is_intersection"].flag,
            )
        )
    if not lanes:
        raise archive.refuse("lanes that vehicles drive on", "none", within="lane_segments")
    areas = [_points(area["area_boundary"]) for area in archive["drivable_areas"].values()]
    crossings = [
        np.concatenate([_points(crossing["edge1"]), _points(crossing["edge2"])[::-1]])
        for crossing in archive["pedestrian_crossings"].values()
    ]
    return RoadMap(lanes, union_rings(areas, level=0.5), crossings, lines)


def _points(line: Entry) -> Array:
    """[V, 2]"""
    points = [(point["x"].number, point["y"].number) for point in line]
    if len(points) < 2:
        raise line.refuse("two points or more", len(points))
    return np.array(points)


def _between(left: Array, right: Array) -> Array:
    """The line half-way between two, by their shares of length."""
    share = np.linspace(0.0, 1.0, max(len(left), len(right), 10))
    sides = []
    for side in (left, right):
        length = arc_lengths(side)
        sides.append(at_places(share, length / max(length[-1], 1e-9), side))
    return (sides[0] + sides[1]) / 2
