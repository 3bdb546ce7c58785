"""An Argoverse 2 scenario: two lanes straight on, an ego behind another car."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

FRAMES, SPEED = 110, 8.0
CORNER = np.array([6000.0, -1400.0])
NAME = "0a0a-made"


def rows(track: str, kind: str, frames: range, x: float, y: float, speed: float) -> list[dict]:
    return [
        {
            "track_id": track,
            "object_type": kind,
            "timestep": frame,
            "position_x": CORNER[0] + x + speed * 0.1 * frame,
            "position_y": CORNER[1] + y,
            "heading": 0.0,
            "velocity_x": speed,
            "velocity_y": 0.0,
            "scenario_id": NAME,
            "city": "austin",
        }
        for frame in frames
    ]


def tracks() -> list[dict]:
    return [
        *rows("7", "vehicle", range(FRAMES), 30.0, 0.0, SPEED),
        *rows("AV", "vehicle", range(FRAMES), 0.0, 0.0, SPEED),
        *rows("9", "pedestrian", range(40, 60), 60.0, -4.0, 0.0),
    ]


def line(x0: float, y0: float, x1: float, y1: float) -> list[dict]:
    return [{"x": CORNER[0] + x, "y": CORNER[1] + y, "z": 0.0} for x, y in ((x0, y0), (x1, y1))]


def lane(name: int, x0: float, x1: float, y: float, **changed: Any) -> dict:
    return {
        "id": name,
        "is_intersection": False,
        "lane_type": "VEHICLE",
        "left_lane_boundary": line(x0, y + 2, x1, y + 2),
        "left_lane_mark_type": "DASHED_WHITE",
        "right_lane_boundary": line(x0, y - 2, x1, y - 2),
        "right_lane_mark_type": "NONE",
        "successors": [],
        **changed,
    }


def road() -> dict[str, dict]:
    lanes = [
        lane(1, -50, 80, 0, successors=[2]),
        lane(2, 80, 250, 0, is_intersection=True, right_lane_mark_type="SOLID_WHITE"),
        lane(3, -50, 250, 4),
        lane(4, -50, 250, -3, lane_type="BIKE"),
    ]
    area = [*line(-50, -2, 250, -2), *line(250, 6, -50, 6)]
    crossing = {"id": 5, "edge1": line(120, -2, 120, 6), "edge2": line(124, -2, 124, 6)}
    return {
        "lane_segments": {str(each["id"]): each for each in lanes},
        "drivable_areas": {"8": {"id": 8, "area_boundary": area}},
        "pedestrian_crossings": {"5": crossing},
    }


def recording() -> dict[str, Any]:
    return {"states": tracks(), "map": road()}


def write(folder: Path, made: dict[str, Any]) -> Path:
    """Write the tracks (or the bytes in their place) and the map, if there is one."""
    import pyarrow
    import pyarrow.parquet

    file = folder / f"scenario_{NAME}.parquet"
    if isinstance(made["states"], bytes):
        file.write_bytes(made["states"])
    else:
        pyarrow.parquet.write_table(pyarrow.Table.from_pylist(made["states"]), file)
    if "map" in made:
        (folder / f"log_map_archive_{NAME}.json").write_text(json.dumps(made["map"]))
    return folder
