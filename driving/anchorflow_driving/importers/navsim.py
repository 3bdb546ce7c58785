"""NAVSIM and OpenScene logs (Dauner et al., 2024): a pickled list of frames at 2 Hz."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from anchorflow_driving.contours import keyholed, union_rings
from anchorflow_driving.errors import LogError
from anchorflow_driving.geometry import Array, ahead_of, out_of_frame
from anchorflow_driving.importers.fields import Entry, chosen_scene
from anchorflow_driving.importers.geopackage import Feature, key_value, layers, read_features
from anchorflow_driving.importers.plain_pickle import load_plain_pickle
from anchorflow_driving.importers.recording import (
    Track,
    flat_pose,
    is_near,
    recorded_log,
    surroundings,
    velocities,
)
from anchorflow_driving.importers.sensor_files import SensorFile, SensorFiles, lens_of, mounted
from anchorflow_driving.log import CYCLIST, PEDESTRIAN, STATIC, VEHICLE, DrivingLog, Lane, RoadMap

EGO_SIZE = (5.176, 2.297)
"""Length and width of nuPlan's recording Chrysler Pacifica, m."""
EGO_AHEAD = 1.461
"""m from its rear axle, whose pose is recorded, to its middle."""
KINDS = {
    "vehicle": VEHICLE,
    "pedestrian": PEDESTRIAN,
    "bicycle": CYCLIST,
    "traffic_cone": STATIC,
    "barrier": STATIC,
    "czone_sign": STATIC,
    "generic_object": STATIC,
}
DRIVABLE = ("lane_groups_polygons", "lane_group_connectors", "intersections", "carpark_areas")
"""Layers whose union may be driven on, as in NAVSIM 1.1."""
CHANNELS = ("CAM_L0", "CAM_F0", "CAM_R0")
CONNECTORS = "gen_lane_connectors_scaled_width_polygons"


@dataclass(frozen=True, eq=False)
class _Boxes:
    """One of the others, as it was found in frames."""

    kind: int
    time: list[float] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    sizes: list[Array] = field(default_factory=list)


def import_navsim(
    path: Path,
    *,
    map_file: Path | None = None,
    scene: str | None = None,
    sensors: Path | None = None,
    rectified: bool = True,
) -> tuple[DrivingLog, Counter[str]]:
    """The log of a scene, with every window whose recorded future is good, and what was counted.

    Boxes are interpolated between frames by straight lines, headings the short way; their
    velocities are those of their places. Tracks seen once are left out. The pickle may hold arrays,
    numbers, texts and containers; nothing in it is run.

    map_file: nuPlan's `map.gpkg` of the city, since the pickle holds no map
    scene: its `scene_token`; needed where there are several
    sensors: the folder of sensor blobs that `data_path` and `lidar_path` begin from; the recording
        vehicle, and no other, is an ego then, and sees what its cameras and its LiDAR recorded
    rectified: whether pictures are turned into those of the reference cameras

    Raises `LogError`.
    """
    frames = _frames(Entry(path, "", load_plain_pickle(path)), scene)
    city = frames[0]["map_location"].text
    if map_file is None:
        raise LogError(path, "map", expected=f"the map.gpkg of {city} (--map)", found="none")
    time = np.array([frame["timestamp"].number for frame in frames]) / 1e6
    if (late := np.flatnonzero(np.diff(time) <= 0)).size:
        found = f"{np.diff(time)[late[0]]:g} s after the frame before"
        raise frames[late[0] + 1].refuse("a later time", found, within="timestamp")
    time -= time[0]
    axle = np.stack(
        [flat_pose(each["ego2global_translation"], each["ego2global_rotation"]) for each in frames]
    )
    counts: Counter[str] = Counter()
    ego = _ego(frames, time, axle)
    tracks = [ego, *_others(frames, time, axle, counts)]
    log, windows = recorded_log(
        tracks,
        read_map(map_file, surroundings(tracks), counts),
        name=f"{frames[0]['log_name'].text} {frames[0]['scene_token'].text}",
        source="navsim",
        licence="nuPlan's and OpenScene's terms of use",
        city=city,
        path=path,
        origin=ego.poses[0, :2],
        sensors=None if sensors is None else _sensor_files(frames, time, axle, sensors, rectified),
        tokens=dict(zip(time.tolist(), (frame["token"].text for frame in frames), strict=True)),
    )
    return log, counts + windows


def _frames(root: Entry, scene: str | None) -> list[Entry]:
    scenes: dict[str, list[Entry]] = {}
    for frame in root:
        scenes.setdefault(frame["scene_token"].text, []).append(frame)
    scene = chosen_scene(root, [*scenes], scene, within="scene_token")
    if len(scenes[scene]) < 2:
        raise root.refuse("two frames or more", len(scenes[scene]), within="scene_token")
    return scenes[scene]


def _ego(frames: Sequence[Entry], time: Array, axle: Array) -> Track:
    vx, vy, _, _ = np.stack([frame["ego_dynamic_state"].numbers(4) for frame in frames]).T
    # The middle goes sideways where the axle does not.
    vy = vy + EGO_AHEAD * np.gradient(np.unwrap(axle[:, 2]), time)
    turned = np.column_stack([np.zeros((len(axle), 2)), axle[:, 2]])
    velocity = out_of_frame(np.stack([vx, vy], -1), turned)
    return Track(VEHICLE, EGO_SIZE, time, ahead_of(axle, EGO_AHEAD), velocity)


def _sensor_files(
    frames: Sequence[Entry], time: Array, axle: Array, folder: Path, rectified: bool
) -> SensorFiles:
    cameras: list[list[SensorFile]] = [[] for _ in CHANNELS]
    lidar = []
    for frame, now, pose in zip(frames, time.tolist(), axle, strict=True):
        swept = mounted(frame["lidar2ego_translation"], frame["lidar2ego_rotation"])
        lidar.append(SensorFile(now, frame["lidar_path"].text, swept, pose))
        for channel, files in zip(CHANNELS, cameras, strict=True):
            camera = frame["cams"][channel]
            # The camera's place does not matter, its direction does.
            turn = swept[:, :3] @ camera["sensor2lidar_rotation"].numbers(3, 3)
            mount = np.column_stack([turn, np.zeros(3)])
            lens = lens_of(camera["cam_intrinsic"], camera["distortion"])
            files.append(SensorFile(now, camera["data_path"].text, mount, pose, lens))
    return SensorFiles(folder, rectified, cameras, lidar)


def _others(frames: Sequence[Entry], time: Array, axle: Array, counts: Counter[str]) -> list[Track]:
    found: dict[str, _Boxes] = {}
    for frame, now, pose in zip(frames, time.tolist(), axle, strict=True):
        boxes = frame["anns"]["gt_boxes"].numbers(None, 7)  # x, y, z, length, width, height, yaw
        if (boxes[:, 3:5] <= 0).any():
            raise frame.refuse(
                "lengths and widths above 0", boxes[:, 3:5].min(), within="anns.gt_boxes"
            )
        names = _texts(frame["anns"]["gt_names"], len(boxes))
        tokens = _texts(frame["anns"]["track_tokens"], len(boxes))
        if len(set(tokens)) != len(tokens):
            raise frame.refuse("each track once", "twice", within="anns.track_tokens")
        for box, name, token in zip(boxes, names, tokens, strict=True):
            if name not in KINDS:
                told = f"one of {', '.join(KINDS)}"
                raise frame.refuse(told, repr(name), within="anns.gt_names")
            one = found.setdefault(token, _Boxes(KINDS[name]))
            one.time.append(now)
            one.poses.append(out_of_frame(box[[0, 1, 6]], pose))
            one.sizes.append(box[3:5])
    tracks = []
    for one in found.values():
        if len(one.time) < 2:
            counts["dropped: track seen once"] += 1
            continue
        length, width = np.median(one.sizes, axis=0).tolist()
        when, poses = np.array(one.time), np.stack(one.poses)
        moves = velocities(when, poses[:, :2])
        tracks.append(Track(one.kind, (length, width), when, poses, moves))
    return tracks


def _texts(entry: Entry, count: int) -> list[str]:
    """A list or an array of texts."""
    values = np.asarray(entry.value).tolist() if count else []
    if (
        not isinstance(values, list)
        or len(values) != count
        or not all(isinstance(value, str) for value in values)
    ):
        raise entry.refuse(f"{count} texts", values)
    return values


def read_map(path: Path, box: tuple[Array, Array], counts: Counter[str]) -> RoadMap:
    """Read the map near a box (its low and high corner, in UTM coordinates).

    Lane connectors belong to a junction. Painted lines are left out: they have no named kinds.

    Raises `LogError`.
    """
    system = key_value(path, "meta", "projectedCoordSystem")
    code = re.fullmatch(r"epsg:(32[67](0[1-9]|[1-5]\d|60))", system.lower())
    if code is None:
        raise LogError(
            path, "meta.projectedCoordSystem", expected="a zone of UTM", found=repr(system)
        )
    zone = int(code[1])
    lanes = _lanes(path, zone, box)
    if not lanes:
        raise LogError(path, "lanes_polygons", expected="lanes near the tracks", found="none")
    drivable: list[Array] = []
    for layer in DRIVABLE:
        if layer in layers(path):
            drivable += _polygons(read_features(path, layer, zone=zone), box)
        else:
            counts[f"dropped: layer {layer}, which the map lacks"] += 1
    return RoadMap(
        lanes,
        union_rings(drivable, level=0.5, within=box),
        list(_polygons(read_features(path, "crosswalks", zone=zone), box)),
        lines=[],
    )


def _lanes(path: Path, zone: int, box: tuple[Array, Array]) -> list[Lane]:
    centres: dict[str, Array] = {}
    keys = {"lane": "lane_fid", "connector": "lane_connector_fid"}
    for feature in read_features(path, "baseline_paths", *keys.values(), zone=zone):
        for kind, key in keys.items():
            if feature.values[key] is not None and feature.shapes:
                centres[_name(kind, feature, key)] = feature.shapes[0][0]
    after: dict[str, list[str]] = defaultdict(list)
    ends = ("fid", "exit_lane_fid", "entry_lane_fid")
    for feature in read_features(path, "lane_connectors", *ends, zone=zone):
        # A connector begins where a lane is left and ends where one is entered.
        connector = _name("connector", feature, "fid")
        after[_name("lane", feature, "exit_lane_fid")].append(connector)
        after[connector].append(_name("lane", feature, "entry_lane_fid"))
    lanes = []
    outlines = (("lane", "lanes_polygons", "fid"), ("connector", CONNECTORS, "lane_connector_fid"))
    for kind, layer, key in outlines:
        for feature in read_features(path, layer, key, zone=zone):
            name = _name(kind, feature, key)
            if not feature.shapes or not is_near(feature.shapes[0][0], box):
                continue
            if name not in centres:
                raise LogError(
                    path, "baseline_paths", expected=f"one of the {name} of {layer}", found="none"
                )
            outline = feature.shapes[0][0]
            lanes.append(Lane(name, outline, centres[name], after[name], kind == "connector"))
    return lanes


def _name(kind: str, feature: Feature, key: str) -> str:
    """Lanes and connectors are numbered apart; a column with gaps has floats."""
    value = feature.values[key]
    return f"{kind} {int(value) if isinstance(value, float) else value}"


def _polygons(features: Iterator[Feature], box: tuple[Array, Array]) -> Iterator[Array]:
    for feature in features:
        for exterior, *holes in feature.shapes:
            if is_near(exterior, box):
                yield keyholed(exterior, holes)
