"""Pictures of coloured boxes on a plane, seen by a pinhole camera: far ones first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from anchorflow_driving.geometry import Array, box_corners
from anchorflow_driving.sensors.pinhole import PinholeCamera

Colour = tuple[int, int, int]

NEAR = 0.3
"""m before the camera, from where on something is seen."""
SKY, GRASS = (176, 200, 222), (96, 124, 84)
# Corners of a box's sides: 0 to 3 below, 4 to 7 above; and how bright the light makes each.
FACES = (
    ((4, 5, 6, 7), 1.15),
    ((0, 1, 5, 4), 0.95),
    ((1, 2, 6, 5), 0.8),
    ((2, 3, 7, 6), 0.7),
    ((3, 0, 4, 7), 0.85),
)


@dataclass(frozen=True)
class Block:
    """A box [5] x, y, heading, length, width that reaches up to a height, m."""

    box: Array
    height: float
    colour: Colour


def block_corners(box: Array, height: float) -> Array:
    """[8,3] of a box [5] on the ground, its lower four first."""
    footprint = box_corners(box[:3], box[3:])
    return np.concatenate([np.c_[footprint, np.full(4, z)] for z in (0.0, height)])


def paint(
    camera: PinholeCamera, ground: Sequence[tuple[Array, Colour]], blocks: Sequence[Block]
) -> NDArray[np.uint8]:
    """[3,H,W]: areas [n,2] of the ground in their order, and blocks from afar to near."""
    image = Image.new("RGB", (camera.columns, camera.rows), SKY)
    draw = ImageDraw.Draw(image)
    horizon = camera.rows / 2 + camera.focal * np.tan(camera.pitch)
    draw.rectangle((0, horizon, camera.columns, camera.rows), fill=GRASS)
    for area, colour in ground:
        _fill(draw, camera, np.c_[area, np.zeros(len(area))], colour)
    position = np.array(camera.place)
    away = [float(np.linalg.norm(block.box[:2] - position[:2])) for block in blocks]
    for number in np.argsort(away)[::-1]:
        block = blocks[number]
        corners = block_corners(block.box, block.height)
        middles = [corners[list(face)].mean(0) for face, _ in FACES]
        order = np.argsort([-np.linalg.norm(middle - position) for middle in middles])
        for side in order:
            face, light = FACES[side]
            red, green, blue = (min(255, int(light * value)) for value in block.colour)
            _fill(draw, camera, corners[list(face)], (red, green, blue))
    return np.ascontiguousarray(np.asarray(image).transpose(2, 0, 1))


def frames(camera: PinholeCamera, point: Array) -> bool:
    """Whether a world point [3] lies within the picture, hidden or not."""
    seen = camera.seen(point[None])
    if seen[0, 2] < NEAR:
        return False
    ((x, y),) = camera.project(seen)
    return bool(0 <= x < camera.columns and 0 <= y < camera.rows)


def hidden(camera: PinholeCamera, point: Array, blocks: Sequence[Block]) -> bool:
    """Whether a block stands between the camera and a point [2], seen from above."""
    eye = np.array(camera.place[:2])
    share = np.linspace(0.0, 1.0, 200)[:, None]
    line = eye + share * (point - eye)
    for block in blocks:
        x, y, heading, length, width = block.box
        local = (line - [x, y]) @ np.array(
            [[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]]
        )
        if (np.abs(local) < [length / 2, width / 2]).all(1).any():
            return True
    return False


def _fill(draw: ImageDraw.ImageDraw, camera: PinholeCamera, points: Array, colour: Colour) -> None:
    """A flat polygon [n,3], cut off where it comes too near."""
    seen = camera.seen(points)
    kept: list[Array] = []
    for here, after in zip(seen, np.roll(seen, -1, 0), strict=True):
        if here[2] >= NEAR:
            kept.append(here)
        if (here[2] >= NEAR) != (after[2] >= NEAR):
            share = (NEAR - here[2]) / (after[2] - here[2])
            kept.append(here + share * (after - here))
    if len(kept) >= 3:
        draw.polygon([*map(tuple, camera.project(np.stack(kept)))], fill=colour)
