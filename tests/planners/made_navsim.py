"""A NAVSIM log with a map as nuPlan's: two lanes, an ego behind another car."""

from __future__ import annotations

import pickle
import sqlite3
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from made_sensors import picture, sweep, turned, write_pcd, write_picture

from anchorflow_driving.importers.geopackage import utm
from anchorflow_driving.importers.navsim import CONNECTORS

ZONE, CORNER, HEADING = 32611, np.array([664_000.0, 3_997_000.0]), 0.6
FRAMES, SPEED = 25, 8.0
BEGIN = 1_624_000_000_000_000


def on_the_map(points: Any) -> np.ndarray:
    """UTM coordinates of points [..., 2] along and left of the street."""
    cos, sin = np.cos(HEADING), np.sin(HEADING)
    return CORNER + np.asarray(points, float) @ [[cos, sin], [-sin, cos]]


def frames(scene: str = "scene-a") -> list[dict]:
    made = []
    for k in range(FRAMES):
        x = SPEED * 0.5 * k
        boxes = [
            [30.0, 0.0, 0.8, 4.6, 1.9, 1.6, 0.0],
            [60.0 - x, -4.0, 0.9, 0.6, 0.7, 1.8, 3.0 + 0.1 * k],
        ]
        names, tokens = ["vehicle", "pedestrian"], ["car", "walker"]
        if k == 3:
            boxes.append([5.0, 5.0, 0.5, 0.4, 0.4, 0.7, 0.0])
            names.append("traffic_cone")
            tokens.append("cone")
        pose = [np.cos(HEADING / 2), 0.0, 0.0, np.sin(HEADING / 2)]
        made.append(
            {
                "token": f"{scene}-{k}",
                "timestamp": BEGIN + 500_000 * k,
                "log_name": "2021.06.14",
                "scene_token": scene,
                "map_location": "us-nv-las-vegas-strip",
                "ego2global_translation": np.array([*on_the_map([x, 0.0]), 0.0]),
                "ego2global_rotation": np.array(pose),
                "ego_dynamic_state": [SPEED, 0.0, 0.0, 0.0],
                "driving_command": np.array([0, 1, 0, 0]),
                "anns": {
                    "gt_boxes": np.array(boxes, np.float32),
                    "gt_names": np.array(names),
                    "track_tokens": tokens,
                },
            }
        )
    return made


def degrees(points: np.ndarray) -> np.ndarray:
    """Longitude and latitude of UTM coordinates [V, 2], by Newton's method."""
    found: Any = np.full_like(points, [-115.0, 36.0])
    step = 1e-4
    for _ in range(6):
        here = utm(found, ZONE)
        slopes = [(utm(found + axis, ZONE) - here) / step for axis in np.eye(2) * step]
        jacobian = np.stack(slopes, -1)
        found = found + np.linalg.solve(jacobian, (points - here)[..., None])[..., 0]
    return found


def blob(*rings: Any, polygon: bool = True, system: int = 4326) -> bytes:
    """A GeoPackage's geometry; lines have no z here, polygons do."""
    body = struct.pack("<2sBBi", b"GP", 0, 1, system)
    corners = [on_the_map(ring) for ring in rings]
    if system == 4326:
        corners = [degrees(ring) for ring in corners]
    if not polygon:
        return body + struct.pack("<BII", 1, 2, len(corners[0])) + corners[0].tobytes()
    body += struct.pack("<BII", 1, 6, 1) + struct.pack("<BII", 1, 1003, len(rings))
    for ring in corners:
        body += struct.pack("<I", len(ring)) + np.column_stack([ring, 0 * ring[:, 0]]).tobytes()
    return body


def rectangle(x0: float, y0: float, x1: float, y1: float) -> list[tuple[float, float]]:
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]


def write_map(
    path: Path, *, left_out: str = "", system: int = 4326, statements: Sequence[str] = ()
) -> None:
    def area(*rings: Any) -> bytes:
        return blob(*rings, system=system)

    def line(x0: float, x1: float, y: float) -> bytes:
        points = [(x, y) for x in np.linspace(x0, x1, 9)]
        return blob(points, polygon=False, system=system)

    road = area(rectangle(-50, -2, 250, 6), rectangle(150, 3, 160, 5))
    layers: dict[str, tuple[list[str], list[tuple]]] = {
        "lanes_polygons": (
            ["fid", "geom"],
            [
                (1, area(rectangle(-50, -2, 80, 2))),
                (2, area(rectangle(90, -2, 250, 2))),
                (3, area(rectangle(-50, 2, 250, 6))),
                (4, area(rectangle(5000, 2, 5010, 6))),
            ],
        ),
        CONNECTORS: (["lane_connector_fid", "geom"], [("1", area(rectangle(80, -2, 90, 2)))]),
        "lane_connectors": (
            ["fid", "exit_lane_fid", "entry_lane_fid", "geom"],
            [(1, 1, 2, line(80, 90, 0))],
        ),
        "baseline_paths": (
            ["lane_fid", "lane_connector_fid", "geom"],
            [
                (1.0, None, line(-50, 80, 0)),
                (2.0, None, line(90, 250, 0)),
                (3.0, None, line(-50, 250, 4)),
                (None, 1.0, line(80, 90, 0)),
            ],
        ),
        "lane_groups_polygons": (["geom"], [(road,)]),
        "intersections": (["geom"], [(area(rectangle(78, -2, 92, 6)),)]),
        "lane_group_connectors": (["geom"], []),
        "crosswalks": (["geom"], [(area(rectangle(120, -2, 124, 6)),)]),
    }
    file = sqlite3.connect(path)
    file.execute("CREATE TABLE gpkg_geometry_columns (table_name, column_name)")
    file.execute("CREATE TABLE meta (key, value)")
    file.execute("INSERT INTO meta VALUES ('projectedCoordSystem', 'epsg:32611')")
    for name, (columns, rows) in layers.items():
        columns = [column for column in columns if f"{name}.{column}" != left_out]
        if name == left_out:
            continue
        file.execute(f"CREATE TABLE {name} ({', '.join(columns)})")
        file.execute("INSERT INTO gpkg_geometry_columns VALUES (?, 'geom')", (name,))
        marks = ", ".join("?" * len(columns))
        file.executemany(
            f"INSERT INTO {name} VALUES ({marks})", [row[-len(columns) :] for row in rows]
        )
    for statement in statements:
        file.execute(statement)
    file.commit()
    file.close()


def recording(*scenes: str) -> dict[str, Any]:
    """Return the frames of scenes, and how their map is written."""
    made = [frame for scene in scenes or ("scene-a",) for frame in frames(scene)]
    return {"frames": made, "left_out": "", "statements": []}


CAMERAS = {"CAM_L0": turned(0.95), "CAM_F0": turned(0.03, 0.02), "CAM_R0": turned(-0.97)}
INTRINSIC = np.array([[130.0, 0.0, 80.0], [0.0, 130.0, 45.0], [0.0, 0.0, 1.0]])
DISTORTION = (-0.35, 0.17, -0.002, 0.0005, -0.05)
"""About that of nuPlan's lenses."""
LIDAR = np.column_stack([np.eye(3), [0.0, 0.0, 0.0]])


def add_sensors(made: dict[str, Any], folder: Path) -> None:
    """Write the pictures and the sweep of each frame, and what the frames tell of them."""
    pictures = {name: picture(INTRINSIC, turn, DISTORTION) for name, turn in CAMERAS.items()}
    for k, frame in enumerate(made["frames"]):
        x = SPEED * 0.5 * k
        frame["lidar_path"] = f"log/MergedPointCloud/{frame['token']}.pcd"
        frame |= {"lidar2ego_translation": np.zeros(3), "lidar2ego_rotation": [1.0, 0, 0, 0]}
        write_pcd(folder / frame["lidar_path"], sweep(x, LIDAR))
        frame["cams"] = {}
        for name, made_picture in pictures.items():
            file = f"log/{name}/{frame['token']}.jpg"
            write_picture(folder / file, made_picture)
            frame["cams"][name] = {
                "data_path": file,
                "sensor2lidar_rotation": CAMERAS[name],
                "sensor2lidar_translation": np.array([1.7, 0.0, 1.5]),
                "cam_intrinsic": INTRINSIC,
                "distortion": np.array(DISTORTION),
            }


def write(folder: Path, made: dict[str, Any]) -> Path:
    """Write the frames and, beside them, the map (or the bytes in its place)."""
    file = folder / "map.gpkg"
    if "map" in made:
        file.write_bytes(made["map"])
    else:
        write_map(file, left_out=made["left_out"], statements=made["statements"])
    path = folder / "a.pkl"
    path.write_bytes(pickle.dumps(made["frames"], protocol=pickle.HIGHEST_PROTOCOL))
    return path
