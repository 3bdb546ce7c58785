"""Writes cooperative recordings in the layout of DAIR-V2X (Yu et al., CVPR 2022)."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from anchorflow_driving.cooperative.painter import block_corners
from anchorflow_driving.errors import place_to_write
from anchorflow_driving.geometry import Array

Pixels = NDArray[np.uint8]

GROUP = ":"
"""Between a log and its ego in a sequence's name; sequences of one log are held out together."""
HEIGHT = 1.5
"""m, of the boxes that are written."""
QUALITY = 85  # of JPEG files
MICROSECONDS = 1e6
SIDES = ("vehicle-side", "infrastructure-side", "cooperative")
INFO = "data_info.json"
"""The list of frames of each side."""


@dataclass(frozen=True, eq=False)
class CooperativeFrame:
    """A moment of a drive, in the world: metres, radians, heading counter-clockwise from x.

    time_s: from the drive's begin; pose: [3] x, y, heading of the vehicle's rear axle
    vehicle_image, infrastructure_image: [3,H,W]; both, or neither where only the pose is known
    boxes: [n,5] x, y, heading, length, width of the others
    """

    time_s: float
    pose: Array
    vehicle_image: Pixels | None
    infrastructure_image: Pixels | None
    boxes: Array


def write_recording(
    folder: Path, drives: Iterable[tuple[str, Iterable[CooperativeFrame]]], *, hz: float = 10.0
) -> int:
    """Write a recording of named drives; return its number of picture pairs.

    Every frame has a pose, a time and a label; frames with pictures are pairs as well.

    Raises `LogError` if a file cannot be written.
    """
    vehicle: list[dict[str, Any]] = []
    infrastructure: list[dict[str, Any]] = []
    pairs: list[dict[str, Any]] = []
    number = 0
    for side in SIDES:  # A recording that is cut off has no list.
        (folder / side / INFO).unlink(missing_ok=True)
    for name, frames in drives:
        began = number / hz
        for frame in frames:
            stem = f"{number:06d}"
            number += 1
            stamp = str(round((began + frame.time_s) * MICROSECONDS))
            vehicle.append(_vehicle_frame(folder, stem, stamp, name, frame))
            _write_json(folder / "cooperative/label_world" / f"{stem}.json", _boxes(frame.boxes))
            if frame.vehicle_image is None or frame.infrastructure_image is None:
                continue
            infrastructure.append(
                {"image_path": f"image/{stem}.jpg", "image_timestamp": stamp, "batch_id": name}
            )
            paths = {}
            for side, pixels in (
                ("vehicle", frame.vehicle_image),
                ("infrastructure", frame.infrastructure_image),
            ):
                path = f"{side}-side/image/{stem}.jpg"
                _write_picture(folder / path, pixels)
                paths[f"{side}_image_path"] = path
            label = f"cooperative/label_world/{stem}.json"
            pairs.append({**paths, "cooperative_label_path": label})
    for side, entries in zip(SIDES, (vehicle, infrastructure, pairs), strict=True):
        _write_json(folder / side / INFO, entries)
    return len(pairs)


def _vehicle_frame(
    folder: Path, stem: str, stamp: str, name: str, frame: CooperativeFrame
) -> dict[str, Any]:
    x, y, heading = frame.pose.tolist()
    cos, sin = np.cos(heading), np.sin(heading)
    pose = {
        "rotation": [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]],
        "translation": [[x], [y], [0.0]],
    }
    path = f"calib/novatel_to_world/{stem}.json"
    _write_json(folder / "vehicle-side" / path, pose)
    return {
        "image_path": f"image/{stem}.jpg",
        "image_timestamp": stamp,
        "calib_novatel_to_world_path": path,
        "batch_id": name,
    }


def _boxes(boxes: Array) -> list[dict[str, Any]]:
    return [{"type": "car", "world_8_points": block_corners(box, HEIGHT).tolist()} for box in boxes]


def _write_picture(path: Path, pixels: Pixels) -> None:
    picture = io.BytesIO()
    Image.fromarray(pixels.transpose(1, 2, 0)).save(picture, "JPEG", quality=QUALITY)
    _write(path, picture.getvalue())


def _write_json(path: Path, value: Any) -> None:
    _write(path, json.dumps(value).encode())


def _write(path: Path, content: bytes) -> None:
    with place_to_write(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
