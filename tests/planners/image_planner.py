"""A planner of the other kind, small enough to be worked out by hand: a camera image and the ego's
status in, six of eight poses each out, the best first.

    brightness = mean of the image / 255        speed = status[0]
    trajectory k:  x = speed t,  y = (k - 2.5) t,  heading = 0.1 (k - 2.5),    t = 0.5 … 4.0 s
    score k = -(5 brightness - k)²              so brightness chooses the trajectory
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from written_graphs import tensor, write_graphs, write_manifest

K, T, D = 6, 8, 3
HEIGHT, WIDTH = 16, 24
TIMES = 0.5 * np.arange(1, T + 1, dtype=np.float32)

ENCODE = """
<ir_version: 10, opset_import: ["": 20]>
encode (uint8[B,3,16,24] camera, float[B,4] ego_status)
    => (float[B,1] brightness, float[B,1] speed, float[B,3,16,24] bev_semantics)
<int64[3] all = {1, 2, 3}, int64[1] one = {1}, float white = {255.0},
 int64[1] first = {0}, int64[1] second = {1}>
{
    pixels = Cast <to = 1> (camera)
    bev_semantics = Div (pixels, white)
    mean = ReduceMean <keepdims = 0> (bev_semantics, all)
    brightness = Unsqueeze (mean, one)
    speed = Slice (ego_status, first, second, one)
}
"""

SCORE = """
<ir_version: 10, opset_import: ["": 20]>
score (float[B,1] brightness, float[B,1] speed)
    => (float[B,6,8,3] trajectories, float[B,6] scores, float[B,6,2] goals)
<float five = {5.0}, int64[2] spread = {2, 3}, int64[1] last = {7}, int64[1] eighth = {8},
 int64[1] steps = {2}, int64[1] zero = {0}, int64[1] two = {2}, int64[1] parts = {3}>
{
    wide = Unsqueeze (speed, spread)
    forward = Mul (wide, along)
    trajectories = Add (forward, aside)
    aim = Mul (brightness, five)
    away = Sub (aim, order)
    square = Mul (away, away)
    scores = Neg (square)
    ends = Slice (trajectories, last, eighth, steps)
    flat = Squeeze (ends, steps)
    goals = Slice (flat, zero, two, two)
}
"""


def expected(brightness: float, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Trajectories [K,T,D] and scores [K], the best first."""
    aside = np.arange(K) - 2.5
    x = np.broadcast_to(speed * TIMES, (K, T))
    y = aside[:, None] * TIMES
    heading = np.broadcast_to(0.1 * aside[:, None], (K, T))
    scores = -((5 * brightness - np.arange(K)) ** 2)
    best = np.argsort(-scores, kind="stable")
    return np.stack([x, y, heading], -1)[best], scores[best]


def write_image_bundle(folder: Path) -> Path:
    """The bundle, in a folder that is there."""
    along, aside = np.zeros((2, 1, K, T, D), np.float32)
    along[..., 0], aside[..., 1:] = TIMES, expected(0.0, 1.0)[0][..., 1:]
    constants = {"along": along, "aside": aside, "order": np.arange(K, dtype=np.float32)[None]}
    status = {"unit": "m/s, m/s, m/s^2, m/s^2", "range": [-60.0, 60.0]}
    extras = [
        tensor("goals", "float32", "B", "N", 2, unit="m"),
        tensor("bev_semantics", "float32", "B", 3, HEIGHT, WIDTH, range=[0.0, 1.0]),
    ]
    return write_manifest(
        folder,
        "tiny-camera",
        request={
            "inputs": [
                tensor("camera", "uint8", "B", 3, HEIGHT, WIDTH),
                tensor("ego_status", "float32", "B", 4, **status),
            ]
        },
        sampler={"kind": "vocabulary", "size": K},
        answer={"components": ["x", "y", "heading"], "arrays": ["scores"], "extras": extras},
        graphs=write_graphs(folder, {"encode": ENCODE, "score": SCORE}, {"score": constants}),
    )
