"""nuScenes tables and map: two lanes straight on, an ego behind another car."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from made_sensors import picture, sweep, turned, write_pcd_bin, write_picture
from scipy.spatial.transform import Rotation

Tables = dict[str, Any]

SECONDS, SPEED = 12, 8.0
BEGIN = 1_531_883_530_449_377  # microseconds
ORIGIN = (410.0, 1170.0)


def rotation(heading: float) -> list[float]:
    return [float(np.cos(heading / 2)), 0.0, 0.0, float(np.sin(heading / 2))]


def place(x: float, y: float) -> list[float]:
    return [ORIGIN[0] + x, ORIGIN[1] + y, 0.5]


def scene_tables(name: str) -> Tables:
    samples = [
        {"token": f"{name}-s{k}", "scene_token": name, "timestamp": BEGIN + 500_000 * k}
        for k in range(2 * SECONDS + 1)
    ]
    annotations = []
    for k, sample in enumerate(samples):
        lead = {"instance_token": "car", "translation": place(30 + SPEED / 2 * k, 0.2)}
        # Turns on the spot, through the jump of the angle.
        walker = {"instance_token": "walker", "translation": place(60.0, -4.0)}
        for box, size, heading in (
            (lead, [1.9, 4.6, 1.7], 0.0),
            (walker, [0.6, 0.7, 1.8], 3.0 + 0.1 * k),
        ):
            annotations.append(
                box
                | {
                    "token": f"{box['instance_token']}{k}",
                    "sample_token": sample["token"],
                    "size": size,
                    "rotation": rotation(heading),
                }
            )
    annotations.append(annotations[0] | {"token": "cone0", "instance_token": "cone"})
    poses = [
        {
            "token": f"{name}-p{k}",
            "timestamp": BEGIN + 50_000 * k,
            "translation": [*place(SPEED * 0.05 * k, 0.0)[:2], 0.0],
            "rotation": rotation(0.0),
        }
        for k in range(20 * SECONDS + 1)
    ]
    data = [
        {
            "token": pose["token"],
            "ego_pose_token": pose["token"],
            "sample_token": samples[min(k // 10, len(samples) - 1)]["token"],
        }
        for k, pose in enumerate(poses)
    ]
    return {
        "scene": [{"token": name, "name": name, "log_token": "log"}],
        "sample": samples,
        "sample_annotation": annotations,
        "sample_data": data,
        "ego_pose": poses,
        "instance": [
            {"token": "car", "category_token": "vehicle.car"},
            {"token": "walker", "category_token": "human"},
            {"token": "cone", "category_token": "cone"},
        ],
        "category": [
            {"token": "vehicle.car", "name": "vehicle.car"},
            {"token": "human", "name": "human.pedestrian.adult"},
            {"token": "cone", "name": "movable_object.trafficcone"},
        ],
        "log": [{"token": "log", "location": "singapore-made"}],
    }


class Nodes:
    """The points of a map, and what is drawn through them."""

    def __init__(self) -> None:
        self.rows: list[dict] = []

    def line(self, *places: tuple[float, float]) -> list[str]:
        """Their tokens."""
        tokens = [f"n{len(self.rows) + k}" for k in range(len(places))]
        for token, (x, y) in zip(tokens, places, strict=True):
            east, north, _ = place(x, y)
            self.rows.append({"token": token, "x": east, "y": north})
        return tokens

    def rectangle(self, token: str, x0: float, y0: float, x1: float, y1: float) -> dict:
        ring = self.line((x0, y0), (x1, y0), (x1, y1), (x0, y1))
        return {"token": token, "exterior_node_tokens": ring, "holes": []}


def straight(x0: float, x1: float, y: float) -> list[dict]:
    start = [*place(x0, y)[:2], 0.0]
    lengths = [0.0, x1 - x0, 0.0]
    return [{"start_pose": start, "shape": "LSR", "radius": 50.0, "segment_length": lengths}]


def road() -> Tables:
    """Lanes a, ab, b on y = 0, lane c beside them, one far away, and a hole in the road."""
    nodes = Nodes()
    whole = nodes.rectangle("road", -50, -2, 250, 6)
    whole["holes"] = [{"node_tokens": nodes.line((150, 3), (160, 3), (160, 5), (150, 5))}]
    return {
        **lanes(),
        "polygon": [
            nodes.rectangle("A", -50, -2, 80, 2),
            nodes.rectangle("B", 90, -2, 250, 2),
            nodes.rectangle("C", -50, 2, 250, 6),
            nodes.rectangle("walk", 120, -2, 124, 6),
            nodes.rectangle("far", 5000, 5000, 5010, 5010),
            whole,
        ],
        "drivable_area": [{"token": "d", "polygon_tokens": ["road"]}],
        "ped_crossing": [{"token": "p", "polygon_token": "walk"}],
        "lane_divider": [{"token": "ld", "lane_divider_segments": divider(nodes)}],
        "road_divider": [{"token": "rd", "line_token": "edge"}],
        "line": [{"token": "edge", "node_tokens": nodes.line((-50, -2), (250, -2))}],
        "node": nodes.rows,
    }


def lanes() -> Tables:
    polygons = {"a": "A", "b": "B", "c": "C", "far": "far"}
    return {
        "lane": [{"token": lane, "polygon_token": of} for lane, of in polygons.items()],
        "lane_connector": [{"token": "ab"}],
        "arcline_path_3": {
            "a": straight(-50, 80, 0),
            "ab": straight(80, 90, 0),
            "b": straight(90, 250, 0),
            "c": straight(-50, 250, 4),
            "far": straight(5000, 5010, 5005),
        },
        "connectivity": {
            "a": {"incoming": [], "outgoing": ["ab"]},
            "ab": {"incoming": ["a"], "outgoing": ["b"]},
            "b": {"incoming": ["ab"], "outgoing": ["gone"]},
            "c": {"incoming": [], "outgoing": []},
        },
    }


def divider(nodes: Nodes) -> list[dict]:
    """Dashed up to x = 100, then solid."""
    tokens = nodes.line((-50, 2), (0, 2), (100, 2), (250, 2))
    kinds = ("NIL", "DOUBLE_DASHED_WHITE", "SINGLE_SOLID_WHITE", "SINGLE_SOLID_WHITE")
    return [
        {"node_token": token, "segment_type": kind}
        for token, kind in zip(tokens, kinds, strict=True)
    ]


def recording(*scenes: str) -> dict[str, Tables]:
    """Return the tables of scenes, and the map expansion."""
    tables, *others = [scene_tables(name) for name in scenes or ("scene-0001",)]
    for other in others:
        for name in ("scene", "sample", "sample_annotation", "sample_data", "ego_pose"):
            tables[name] = tables[name] + other[name]
    return {"tables": tables, "map": road()}


# As on nuScenes' car, but for what a test shall notice: a yaw, a pitch, a LiDAR that looks left.
CAMERAS = {
    "CAM_FRONT_LEFT": turned(np.deg2rad(57.0)),
    "CAM_FRONT": turned(np.deg2rad(2.0), np.deg2rad(-3.0)),
    "CAM_FRONT_RIGHT": turned(np.deg2rad(-54.0)),
}
INTRINSIC = np.array([[126.0, 0.0, 81.0], [0.0, 127.0, 46.0], [0.0, 0.0, 1.0]])
LIDAR = np.column_stack([Rotation.from_euler("z", 90, degrees=True).as_matrix(), [0.9, 0.0, 1.8]])
LATE_S = {"LIDAR_TOP": -0.04}
"""s after a keyframe at which a sensor records; 0.03 for cameras."""


def add_sensors(tables: Tables, folder: Path) -> None:
    """Write pictures and sweeps twice a second, and the rows that tell of them."""
    mounts = {name: np.column_stack([turn, [1.7, 0.0, 1.5]]) for name, turn in CAMERAS.items()}
    mounts |= {"LIDAR_TOP": LIDAR, "RADAR_FRONT": LIDAR}
    pictures = {name: picture(INTRINSIC, turn) for name, turn in CAMERAS.items()}
    tables["sensor"] = [{"token": name, "channel": name} for name in mounts]
    tables["calibrated_sensor"] = [
        {
            "token": f"{name}-now",
            "sensor_token": name,
            "translation": mount[:, 3].tolist(),
            "rotation": np.roll(Rotation.from_matrix(mount[:, :3]).as_quat(), 1).tolist(),
            "camera_intrinsic": INTRINSIC.tolist() if name in CAMERAS else [],
        }
        for name, mount in mounts.items()
    ]
    for row in tables["sample_data"]:
        row |= {"calibrated_sensor_token": "RADAR_FRONT-now", "timestamp": BEGIN, "filename": ""}
    for sample in tables["sample"]:
        for name in (*CAMERAS, "LIDAR_TOP"):
            late = LATE_S.get(name, 0.03)
            x = SPEED * ((sample["timestamp"] - BEGIN) / 1e6 + late)
            token, suffix = f"{sample['token']}-{name}", "jpg" if name in CAMERAS else "pcd.bin"
            time, file = sample["timestamp"] + round(1e6 * late), f"samples/{name}/{token}.{suffix}"
            pose = {"translation": [*place(x, 0.0)[:2], 0.0], "rotation": rotation(0.0)}
            tables["ego_pose"].append({"token": token, "timestamp": time, **pose})
            row = {"token": token, "ego_pose_token": token, "sample_token": sample["token"]}
            row |= {"calibrated_sensor_token": f"{name}-now", "timestamp": time, "filename": file}
            tables["sample_data"].append(row)
            if name in CAMERAS:
                write_picture(folder / file, pictures[name])
            else:
                write_pcd_bin(folder / file, sweep(x, LIDAR))


def write(folder: Path, made: dict[str, Tables]) -> Path:
    files = {f"v1.0-mini/{name}.json": rows for name, rows in made["tables"].items()}
    for name, rows in {**files, "maps/expansion/singapore-made.json": made["map"]}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(json.dumps(rows))
    return folder


if __name__ == "__main__":
    made = recording("scene-0061", "scene-0103")
    add_sensors(made["tables"], Path(sys.argv[1]))
    write(Path(sys.argv[1]), made)
