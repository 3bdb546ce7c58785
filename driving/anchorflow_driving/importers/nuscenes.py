"""nuScenes (Caesar et al., 2020): tables of keyframes at 2 Hz, and the map expansion."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from anchorflow_driving.errors import LogError
from anchorflow_driving.geometry import Array, ahead_of
from anchorflow_driving.importers.fields import Entry, by_token, chosen_scene
from anchorflow_driving.importers.nuscenes_map import read_map
from anchorflow_driving.importers.recording import (
    Track,
    flat_pose,
    frame_times,
    recorded_log,
    resampled_poses,
    surroundings,
    velocities,
)
from anchorflow_driving.importers.sensor_files import SensorFile, SensorFiles, lens_of, mounted
from anchorflow_driving.log import CYCLIST, PEDESTRIAN, STATIC, VEHICLE, DrivingLog

EGO_SIZE = (4.084, 1.730)
"""Length and width of the recording Renault Zoe, m."""
EGO_AHEAD = 1.385
"""m from its rear axle, whose pose is recorded, to its middle."""
# Keyed by prefixes of a category's name; the first match counts.
KINDS = {
    "vehicle.bicycle": CYCLIST,
    "vehicle.motorcycle": CYCLIST,
    "vehicle.": VEHICLE,
    "human.": PEDESTRIAN,
    "animal": PEDESTRIAN,
    "movable_object.": STATIC,
    "static_object.": STATIC,
}


CHANNELS = ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT", "LIDAR_TOP")


def import_nuscenes(
    path: Path,
    *,
    scene: str | None = None,
    sensors: Path | None = None,
    rectified: bool = True,
) -> tuple[DrivingLog, Counter[str]]:
    """The log of a scene, with every window whose recorded future is good, and what was counted.

    Boxes are interpolated between keyframes by straight lines, headings the short way. The ego's
    poses are recorded far more often and are read at 10 Hz. Tracks seen once are left out.

    path: the folder that holds `v1.0-*` and `maps`, or the tables' folder in it
    scene: its name; needed where there are several
    sensors: the folder that holds `samples` and `sweeps`; the recording vehicle, and no other, is
        an ego then, and sees what its cameras and its LiDAR recorded
    rectified: whether pictures are turned into those of the reference cameras

    Raises `LogError`.
    """
    tables = _Tables(_tables_folder(path))
    scenes = {row["name"].text: row for row in tables.rows("scene")}
    chosen = scenes[chosen_scene(tables.rows("scene"), [*scenes], scene, within="scene")]
    samples = {
        row["token"].text: row["timestamp"].number
        for row in tables.rows("sample")
        if row["scene_token"].text == chosen["token"].text
    }
    if len(samples) < 2:
        raise chosen.refuse("two keyframes or more in sample.json", len(samples))
    counts: Counter[str] = Counter()
    ego = _ego(tables, samples)
    tracks = [ego, *_others(tables, samples, counts)]
    recorded_in = tables.row("log", chosen["log_token"])
    place = recorded_in["location"].text
    map_file = tables.folder.parent / "maps" / "expansion" / f"{place}.json"
    road = read_map(map_file, surroundings(tracks), counts)
    log, windows = recorded_log(
        tracks,
        road,
        name=chosen["name"].text,
        source="nuscenes",
        licence="CC BY-NC-SA 4.0, with nuScenes' terms of use",
        city=place,
        path=path,
        origin=ego.poses[0, :2],
        sensors=None if sensors is None else _sensor_files(tables, samples, sensors, rectified),
        tokens={(time - min(samples.values())) / 1e6: token for token, time in samples.items()},
    )
    return log, counts + windows


class _Tables:
    """The tables of a folder, read on first use."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._rows: dict[str, Entry] = {}
        self._by_token: dict[str, dict[str, Entry]] = {}

    def path(self, table: str) -> Path:
        return self.folder / f"{table}.json"

    def rows(self, table: str) -> Entry:
        if table not in self._rows:
            self._rows[table] = Entry.of_json(self.path(table))
        return self._rows[table]

    def row(self, table: str, token: Entry) -> Entry:
        """The row that a foreign key points to."""
        if table not in self._by_token:
            self._by_token[table] = by_token(self.rows(table))
        found = self._by_token[table].get(token.text)
        if found is None:
            raise token.refuse(f"a token of {table}.json", repr(token.text))
        return found


def _tables_folder(path: Path) -> Path:
    if (path / "scene.json").exists():
        return path.resolve()
    folders = sorted(each.parent for each in path.glob("v1.0-*/scene.json"))
    if len(folders) != 1:
        found = ", ".join(folder.name for folder in folders) or "none"
        raise LogError(path, "folder", expected="one v1.0-* with scene.json", found=found)
    return folders[0].resolve()


def _ego(tables: _Tables, samples: dict[str, float]) -> Track:
    """The recording vehicle: its box's middle, at 10 Hz."""
    first, last = min(samples.values()), max(samples.values())
    tokens = {
        row["ego_pose_token"].text
        for row in tables.rows("sample_data")
        if row["sample_token"].text in samples
    }
    rows = [row for row in tables.rows("ego_pose") if row["token"].text in tokens]
    if len(rows) < 2:
        raise LogError(
            tables.path("ego_pose"), "token", expected="two poses or more", found=str(len(rows))
        )
    microseconds, index = np.unique([row["timestamp"].number for row in rows], return_index=True)
    poses = np.stack([flat_pose(rows[at]["translation"], rows[at]["rotation"]) for at in index])
    begin, end = max(first, microseconds[0]), min(last, microseconds[-1])
    now = frame_times((end - begin) / 1e6)
    axle = resampled_poses((microseconds - begin) / 1e6, poses, now)
    middle = ahead_of(axle, EGO_AHEAD)
    since = now + (begin - first) / 1e6
    return Track(VEHICLE, EGO_SIZE, since, middle, velocities(now, middle[:, :2]))


def _sensor_files(
    tables: _Tables, samples: dict[str, float], folder: Path, rectified: bool
) -> SensorFiles:
    """The pictures and sweeps of all times, not of keyframes alone."""
    first = min(samples.values())
    found: dict[str, list[SensorFile]] = {channel: [] for channel in CHANNELS}
    for row in tables.rows("sample_data"):
        if row["sample_token"].text not in samples:
            continue
        calibrated = tables.row("calibrated_sensor", row["calibrated_sensor_token"])
        channel = tables.row("sensor", calibrated["sensor_token"])["channel"].text
        if channel not in found:
            continue
        pose = tables.row("ego_pose", row["ego_pose_token"])
        is_camera = channel != CHANNELS[-1]
        found[channel].append(
            SensorFile(
                time=(row["timestamp"].number - first) / 1e6,
                name=row["filename"].text,
                mount=mounted(calibrated["translation"], calibrated["rotation"]),
                pose=flat_pose(pose["translation"], pose["rotation"]),
                lens=lens_of(calibrated["camera_intrinsic"]) if is_camera else None,
            )
        )
    for channel, files in found.items():
        if not files:
            path = tables.path("sample_data")
            raise LogError(path, "filename", expected=f"files of {channel}", found="none")
    *cameras, lidar = found.values()
    return SensorFiles(folder, rectified, cameras, lidar)


def _others(tables: _Tables, samples: dict[str, float], counts: Counter[str]) -> list[Track]:
    first = min(samples.values())
    boxes: dict[str, list[Entry]] = {}
    for row in tables.rows("sample_annotation"):
        if row["sample_token"].text in samples:
            boxes.setdefault(row["instance_token"].text, []).append(row)
    tracks = []
    for rows in boxes.values():
        rows.sort(key=lambda row: samples[row["sample_token"].text])
        category = tables.row(
            "category", tables.row("instance", rows[0]["instance_token"])["category_token"]
        )["name"]
        kind = next((KINDS[begin] for begin in KINDS if category.text.startswith(begin)), None)
        if kind is None:
            raise category.refuse(f"one that begins with {', '.join(KINDS)}", repr(category.text))
        if len(rows) < 2:
            counts["dropped: track seen once"] += 1
            continue
        time = np.array([samples[row["sample_token"].text] - first for row in rows]) / 1e6
        if (np.diff(time) <= 0).any():
            raise rows[0].refuse("one box of an instance in a sample", "two", within="sample_token")
        width, length, _ = np.median([_size(row["size"]) for row in rows], axis=0)
        poses = np.stack([flat_pose(row["translation"], row["rotation"]) for row in rows])
        moves = velocities(time, poses[:, :2])
        tracks.append(Track(kind, (float(length), float(width)), time, poses, moves))
    return tracks


def _size(size: Entry) -> Array:
    found = size.numbers(3)
    if (found <= 0).any():
        raise size.refuse("width, length and height above 0", found.tolist())
    return found
