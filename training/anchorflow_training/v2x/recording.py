"""A cooperative recording in the layout of DAIR-V2X [1].

    cooperative/data_info.json              pairs: vehicle_image_path, infrastructure_image_path,
                                            cooperative_label_path, all from the folder's root
    cooperative/label_world/*.json          boxes of a pair: `world_8_points`
    vehicle-side/data_info.json             frames: image_path, image_timestamp [µs], batch_id,
                                            calib_novatel_to_world_path, from vehicle-side/
    vehicle-side/calib/novatel_to_world/    poses: rotation 3x3, translation 3x1
    vehicle-side/image/, infrastructure-side/image/
                                            or the published archives of pictures, unpacked beside
                                            the folder: FOLDER-vehicle-side-image/, ...

Sequences are the frames of one `batch_id` in the order of their times. A frame can be asked about
where the 45 frames after it exist, 0.1 s apart: the waypoints are frames 1 to 45 after it. (Taking
45 poses from the frame itself on, as published recipes do, includes the current place, and ends 0.1
s early.)

[1] Yu et al., DAIR-V2X: A Large-Scale Dataset for Vehicle-Infrastructure Cooperative 3D Object
    Detection, CVPR 2022.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from anchorflow_driving.geometry import into_frame
from anchorflow_driving.window import Vehicle
from anchorflow_training.data.poses import (
    SECONDS,
    data_entries,
    forward_axis,
    microseconds,
    novatel_pose,
    planar_poses,
    read_json,
)
from anchorflow_training.dataset import DatasetError

Array = NDArray[np.float64]

COOPERATIVE, VEHICLE, INFRASTRUCTURE = "cooperative", "vehicle-side", "infrastructure-side"
INFO = "data_info.json"
LABELS = "label_world"
PAIR_KEYS = ("vehicle_image_path", "infrastructure_image_path", "cooperative_label_path")
FRAME_KEYS = ("image_path", "image_timestamp", "batch_id", "calib_novatel_to_world_path")
FUTURE = 45
"""Frames after one that is asked about."""
STEP_S = 0.1
JITTER_S = 0.05
"""Tolerance on the time between two frames, STEP_S."""
ROTATION_ERROR = 1e-3
"""Tolerance on the orthogonality of a rotation."""

Fault = Callable[[DatasetError], None]


EGO = Vehicle(4.6, 1.9)
"""The ego's box, m, which recordings lack."""
OWN = 1.5
"""m between a box's middle and the ego's, within which the box is the ego's own."""


@dataclass(frozen=True)
class Pair:
    """What both sides saw at a frame: pictures and boxes, as files.

    name: of the vehicle's picture, as the recording lists it
    """

    name: str
    vehicle_image: Path
    infrastructure_image: Path
    label: Path


@dataclass(frozen=True)
class Sequence:
    """One drive.

    times: [F] s, rising
    poses: [F,3] x, y [m], heading [rad] of the rear axle in the world
    pairs: by the number of the frame
    labels: [F] a file of boxes, or None
    """

    name: str
    times: Array
    poses: Array
    pairs: Mapping[int, Pair]
    labels: tuple[Path | None, ...]

    def label_of(self, frame: int) -> Path | None:
        """The boxes of a frame: its pair's or, without a pair, those of the same name."""
        pair = self.pairs.get(frame)
        return pair.label if pair else self.labels[frame]

    def askable(self) -> Iterator[int]:
        """The frames with a pair, a frame before and 45 after them, without a gap."""
        steps = np.abs(np.diff(self.times) - STEP_S) <= JITTER_S
        for frame in sorted(self.pairs):
            whole = steps[frame - 1 : frame + FUTURE] if frame else steps[:0]
            if len(whole) == FUTURE + 1 and whole.all():
                yield frame

    def waypoints(self, frame: int) -> Array:
        """[45,2] m ahead and to the left of the frame's pose, of the 45 frames after it."""
        after = self.poses[frame + 1 : frame + 1 + FUTURE]
        return into_frame(after, self.poses[frame])[:, :2]

    def speed(self, frame: int) -> float:
        """m/s ahead, from the frame before to this one, which a request can know."""
        moved = into_frame(self.poses[frame - 1 : frame], self.poses[frame])[0]
        return float(-moved[0] / (self.times[frame] - self.times[frame - 1]))

    def turn_rate(self, frame: int) -> float:
        """rad/s to the left, likewise."""
        turned = self.poses[frame, 2] - self.poses[frame - 1, 2]
        return float(turned / (self.times[frame] - self.times[frame - 1]))


def read_recording(folder: Path, *, fault: Fault | None = None) -> list[Sequence]:
    """The sequences of a folder, by name.

    fault: called with each fault, which is then skipped

    Raises `DatasetError` without `fault`, naming the file and what is wrong with it.
    """
    report = fault or _raise
    frames = _frames(folder, report)
    pairs = _pairs(folder, frames, report)
    matrices = {}
    for path, frame in frames.items():
        with told(report):
            matrices[path] = _pose(folder / VEHICLE / frame["calib_novatel_to_world_path"])
    drives: dict[str, list[tuple[float, str]]] = {}
    for path, frame in frames.items():
        if path in matrices:
            drives.setdefault(str(frame["batch_id"]), []).append((frame["time"], path))
    ordered = {name: sorted(drives[name]) for name in sorted(drives)}
    of_drives = {
        name: np.stack([matrices[path] for _, path in drive]) for name, drive in ordered.items()
    }
    axis = forward_axis([*of_drives.values()])
    sequences = []
    for name, drive in ordered.items():
        poses = planar_poses(of_drives[name], axis)
        own = {number: pairs[path] for number, (_, path) in enumerate(drive) if path in pairs}
        times = np.array([time for time, _ in drive]) - drive[0][0]
        files = [folder / COOPERATIVE / LABELS / f"{Path(path).stem}.json" for _, path in drive]
        labels = tuple(file if file.exists() else None for file in files)
        sequences.append(Sequence(name, times, poses, own, labels))
    return sequences


@contextmanager
def told(report: Fault) -> Iterator[None]:
    """Report an error inside the block and continue after it."""
    try:
        yield
    except DatasetError as error:
        report(error)


def _raise(error: DatasetError) -> None:
    raise error


def _frames(folder: Path, report: Fault) -> dict[str, dict[str, Any]]:
    """The vehicle's frames by the path of their picture, from the folder's root."""
    file = folder / VEHICLE / INFO
    frames = {}
    for number, entry in enumerate(_listed(file, report)):
        with told(report):
            _check_keys(file, number, entry, FRAME_KEYS)
            time = microseconds(file, {"image_timestamp": entry["image_timestamp"]}) * SECONDS
            frames[f"{VEHICLE}/{entry['image_path']}"] = {**entry, "time": time}
    return frames


def _pairs(folder: Path, frames: Mapping[str, Any], report: Fault) -> dict[str, Pair]:
    file = folder / COOPERATIVE / INFO
    pairs = {}
    for number, entry in enumerate(_listed(file, report)):
        with told(report):
            _check_keys(file, number, entry, PAIR_KEYS)
            vehicle, infrastructure, label = (str(entry[key]) for key in PAIR_KEYS)
            if vehicle not in frames:
                known = f"a picture that {folder / VEHICLE / INFO} lists"
                raise DatasetError(f"{file}: entry {number}: expected {known}, found {vehicle}")
            seen, shown = (_picture(folder, each) for each in (vehicle, infrastructure))
            pairs[vehicle] = Pair(vehicle, seen, shown, folder / label)
    return pairs


def _picture(folder: Path, listed: str) -> Path:
    """Return the file of a picture, in the folder or where its side's archive was unpacked."""
    side, _, name = listed.partition("/image/")
    file, unpacked = folder / listed, folder.parent / f"{folder.name}-{side}-image" / name
    return unpacked if unpacked.exists() and not file.exists() else file


def _listed(file: Path, report: Fault) -> list[dict[str, Any]]:
    with told(report):
        return data_entries(file)
    return []


def _check_keys(file: Path, number: int, entry: Mapping[str, Any], keys: tuple[str, ...]) -> None:
    for key in keys:
        if not isinstance(entry.get(key), str | int) or entry[key] == "":
            found = sorted(entry)
            raise DatasetError(f"{file}: entry {number}: expected {key}, found {found}")


def _pose(file: Path) -> Array:
    """[3,4] rotation and translation; the rotation is one."""
    matrix = novatel_pose(file)
    rotation = matrix[:, :3]
    if not np.isfinite(matrix).all():
        raise DatasetError(f"{file}: expected finite numbers, found others")
    error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if error > ROTATION_ERROR or np.linalg.det(rotation) < 0:
        raise DatasetError(f"{file}: rotation: expected a rotation, found {rotation.tolist()}")
    return matrix


BROKEN = (OSError, ValueError, SyntaxError, Image.DecompressionBombError)
THUMB = 8
"""The share of a JPEG's pixels, along a side, at which it is decoded to see whether it is whole."""


@dataclass(frozen=True)
class Verdict:
    """faults: each names a file; a recording without one can be trained on"""

    faults: tuple[str, ...]
    sequences: int
    frames: int
    pairs: int
    askable: int

    @property
    def lines(self) -> list[str]:
        """The faults and, at the end, what there is."""
        what = f"{self.sequences} sequences, {self.frames} frames, {self.pairs} pairs"
        return [*self.faults, f"{what}; {self.askable} can be asked about"]


def verify_recording(
    folder: Path, *, progress: Callable[[int, int], object] = lambda *_: None
) -> Verdict:
    """Read everything that V2X-VLM needs of a recording once, and collect the faults.

    progress: called with the number of pairs that are done, and of all
    """
    faults: list[str] = []

    def note(error: DatasetError) -> None:
        faults.append(str(error))

    sequences = read_recording(folder, fault=note)
    pairs = [pair for sequence in sequences for pair in sequence.pairs.values()]
    for number, pair in enumerate(pairs):
        with told(note):
            for file in (pair.vehicle_image, pair.infrastructure_image):
                read_picture(file, thumb=True)
        with told(note):
            read_boxes(pair.label)
        progress(number + 1, len(pairs))
    askable = sum(len([*sequence.askable()]) for sequence in sequences)
    if not askable and not faults:
        faults.append(_nothing_askable(folder, sequences))
    return Verdict(
        tuple(faults),
        len(sequences),
        sum(len(sequence.times) for sequence in sequences),
        len(pairs),
        askable,
    )


def read_picture(file: Path, *, thumb: bool = False) -> NDArray[np.uint8]:
    """Pixels [3,H,W], RGB; of a thumb far fewer. Raises `DatasetError`."""
    try:
        with Image.open(file) as picture:
            if thumb:
                picture.draft("RGB", tuple(max(1, side // THUMB) for side in picture.size))
            pixels = np.asarray(picture.convert("RGB"))
    except BROKEN as error:
        raise DatasetError(f"{file}: expected a picture ({error})") from error
    return np.ascontiguousarray(pixels.transpose(2, 0, 1))


def _nothing_askable(folder: Path, sequences: list[Sequence]) -> str:
    if not any(sequence.pairs for sequence in sequences):
        return f"{folder / COOPERATIVE / INFO}: expected pairs, found none"
    sizes = Counter({sequence.name: len(sequence.times) for sequence in sequences})
    name, longest = sizes.most_common(1)[0]
    return (
        f"{folder / VEHICLE / INFO}: expected a pair with a frame before it and {FUTURE} after it, "
        f"0.1 s apart; the longest batch_id, {name}, has {longest} frames"
    )


def read_boxes(file: Path) -> Array:
    """[n,5] x, y [m], heading [rad], length, width [m] of a label's boxes, or `DatasetError`."""
    entries = read_json(file)
    if not isinstance(entries, list):
        raise DatasetError(f"{file}: expected a list of boxes, found {type(entries).__name__}")
    return np.array([_box(file, number, entry) for number, entry in enumerate(entries)]).reshape(
        -1, 5
    )


def without_own(boxes: Array, pose: Array) -> Array:
    """The boxes but for that of the vehicle at a pose [3], which the roadside sees as well."""
    away = np.linalg.norm(boxes[:, :2] - EGO.middles(pose)[:2], axis=1)
    return boxes[away > OWN]


def _box(file: Path, number: int, entry: Any) -> Array:
    where = f"{file}: box {number}: world_8_points"
    try:
        points = np.asarray(entry["world_8_points"], float)
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{where}: expected 8 points [8,3] ({error})") from error
    if points.shape != (8, 3) or not np.isfinite(points).all():
        raise DatasetError(f"{where}: expected 8 points [8,3], found {list(points.shape)}")
    # The order of corners differs between copies: the four lowest are the footprint.
    footprint = points[np.argsort(points[:, 2], kind="stable")[:4], :2]
    middle = footprint.mean(0)
    angles = np.arctan2(*(footprint - middle).T[::-1])
    ring = footprint[np.argsort(angles)]
    sides = np.roll(ring, -1, 0) - ring
    lengths = np.linalg.norm(sides, axis=1)
    longest = int(lengths.argmax())
    heading = np.arctan2(sides[longest, 1], sides[longest, 0])
    return np.array([*middle, heading, lengths[longest], lengths[(longest + 1) % 4]])
