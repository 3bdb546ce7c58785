"""How good waypoints are: distance to the recorded way, and collisions with recorded boxes.

L2 at 2.5, 3.5 and 4.5 s; a plan collides by a time where the ego's box overlaps a box of one of the
frames up to it. Boxes are those that were there at that very frame, so a plan that leaves the
recorded way is judged by who really was where it goes.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.drivers import waypoint_headings
from anchorflow_driving.geometry import boxes_overlap, into_frame
from anchorflow_training.v2x.dataset import PairDataset
from anchorflow_training.v2x.recording import EGO, FUTURE, STEP_S

Array = NDArray[np.float64]

HORIZONS_S = (2.5, 3.5, 4.5)
NEAR = 2.0
"""m at 4.5 s, within which a plan counts as a success."""


def judge(dataset: PairDataset, indices: NDArray[np.int64], waypoints: Array) -> dict[str, float]:
    """The means over pairs of plans [N,45,2]; `success` is the share that ends within NEAR."""
    driven = np.asarray(dataset.arrays["waypoints"][indices], float)
    away = np.linalg.norm(waypoints - driven, axis=-1)
    hits = np.array(
        [
            _first_hit(dataset, int(index), way)
            for index, way in zip(indices, waypoints, strict=True)
        ]
    )
    row = {"success": float((away[:, -1] < NEAR).mean())}
    for horizon in HORIZONS_S:
        last = round(horizon / STEP_S)
        row[f"l2_{horizon}s"] = float(away[:, last - 1].mean())
        row[f"collision_{horizon}s"] = float((hits <= last).mean())
    for name in ("l2", "collision"):
        row[f"{name}_mean"] = float(np.mean([row[f"{name}_{each}s"] for each in HORIZONS_S]))
    return row


def constant_velocity(dataset: PairDataset, indices: NDArray[np.int64]) -> Array:
    """Return [N,45,2]: straight on at the prompt's speed."""
    times = STEP_S * np.arange(1, FUTURE + 1)
    speed = np.asarray(dataset.arrays["speed"][indices], float)[:, None]
    return np.stack([speed * times, np.zeros((len(speed), FUTURE))], -1).astype(np.float64)


def baselines(dataset: PairDataset, indices: NDArray[np.int64]) -> Mapping[str, Array]:
    """Plans to compare with, by name; `driven` is the record itself."""
    return {
        "driven": np.asarray(dataset.arrays["waypoints"][indices], float),
        "constant velocity": constant_velocity(dataset, indices),
    }


def _first_hit(dataset: PairDataset, index: int, waypoints: Array) -> int:
    """The first frame after now in which the ego touches another, from 1 on; or FUTURE + 1."""
    row = int(dataset.arrays["frame"][index])
    pose = np.asarray(dataset.arrays["poses"][row])
    own = EGO.middles(np.concatenate([waypoints, waypoint_headings(waypoints)[:, None]], -1))
    for step in range(1, FUTURE + 1):
        boxes = dataset.boxes_of(row + step)
        if not len(boxes):
            continue
        others = into_frame(boxes[:, :3], pose)
        if boxes_overlap(own[step - 1], EGO.size, others, boxes[:, 3:]).any():
            return step
    return FUTURE + 1
