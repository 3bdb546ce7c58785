"""Recorded pictures as the reference cameras would have taken them, stitched for a planner."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import map_coordinates

from anchorflow_client.sensors import CAMERA_ROWS, stitch_cameras
from anchorflow_driving.errors import LogError
from anchorflow_driving.geometry import Array
from anchorflow_driving.recorded_sensors import CAMERAS, RecordedSensors
from anchorflow_driving.sensors.pinhole import YAWS, PinholeCamera, reference_camera

Bytes = NDArray[np.uint8]

LEAST_SEEN = 0.5
"""Share of a reference camera's picture that a recorded one must show."""
_OUTSIDE = -10.0  # an index that no picture has


def recorded_camera(sensors: RecordedSensors, frame: int, *, rows: int, columns: int) -> Bytes:
    """The stitched picture of a frame: uint8 [3, rows, columns].

    Rectified pictures are those of the reference cameras: lenses and directions are undone, black
    where nothing was recorded; places are not, which pictures alone do not tell. Others are
    stitched as recorded.

    Raises `LogError` if a picture is missing or cannot be read, or shows something else.
    """
    scale = max(1, math.ceil(rows / CAMERA_ROWS))
    images = []
    for number, (side, yaw) in enumerate(zip(CAMERAS, YAWS, strict=True)):
        path = sensors.picture(number, frame)
        picture = _opened(path, f"camera {side}")
        if not sensors.rectified:
            images.append(np.asarray(picture))
            continue
        lens, turn = sensors.camera_lens[number, frame], sensors.camera_turn[number, frame]
        camera = reference_camera(yaw, scale=scale)
        image, seen = rectified(picture, lens.astype(float), turn.astype(float), camera)
        if seen < LEAST_SEEN:
            expected = f"one that looks about {math.degrees(yaw):.0f} degrees to the left"
            found = f"{seen:.0%} of what that camera sees"
            raise LogError(path, f"camera {side}", expected=expected, found=found)
        images.append(image)
    left, front, right = images
    return stitch_cameras(left, front, right, rows=rows, columns=columns)


def rectified(
    picture: Image.Image, lens: Array, turn: Array, camera: PinholeCamera
) -> tuple[Bytes, float]:
    """A picture as another camera at its place sees it [rows, columns, 3], and how much it shows.

    lens: [9] fx, fy, cx, cy in pixels, a pixel's middle at whole numbers; k1, k2, p1, p2, k3
    turn: [3, 3] from the picture's camera (x right, y down, z ahead) to the vehicle's frame
    """
    focal, middle, distortion = lens[:2], lens[2:4], lens[4:]
    seen = camera.rays @ turn
    ahead = seen[..., 2] > 0
    flat = seen[..., :2] / np.where(ahead, seen[..., 2], 1.0)[..., None]
    # What is smaller in the result is averaged first.
    shrunk = max(1, int(focal[0] / camera.focal))
    column, row = np.moveaxis(
        (focal * distorted(flat, distortion) + middle + 0.5) / shrunk - 0.5, -1, 0
    )
    pixels = np.asarray(picture.reduce(shrunk))
    shown = ahead & (row > -0.5) & (row < len(pixels) - 0.5)
    shown &= (column > -0.5) & (column < pixels.shape[1] - 0.5)
    at = np.where(shown, np.stack([row, column]), _OUTSIDE)
    # Half a pixel at the rim is beyond the last middle.
    at = np.where(shown, at.clip(0, np.array(pixels.shape[:2])[:, None, None] - 1), at)
    image = [map_coordinates(pixels[..., colour], at, order=1, cval=0) for colour in range(3)]
    return np.stack(image, -1).astype(np.uint8), float(shown.mean())


def distorted(flat: Array, lens: Array) -> Array:
    """Points [..., 2] of the plane 1 m ahead after a lens k1, k2, p1, p2, k3 (Brown, 1966)."""
    k1, k2, p1, p2, k3 = lens
    x, y = flat[..., 0], flat[..., 1]
    r = (flat**2).sum(-1)
    radial = 1 + r * (k1 + r * (k2 + r * k3))
    across = x * radial + 2 * p1 * x * y + p2 * (r + 2 * x**2)
    down = y * radial + p1 * (r + 2 * y**2) + 2 * p2 * x * y
    return np.stack([across, down], -1)


def _opened(path: Path, sensor: str) -> Image.Image:
    try:
        with Image.open(path) as picture:
            return picture.convert("RGB")
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise LogError(path, sensor, expected="a picture", found=str(error)) from error
