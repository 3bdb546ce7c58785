"""Curves in closed form, to try a model or a test on before there is data."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.data.file_formats import HeldArray
from anchorflow_training.data.trajectory_dataset import TrajectoryDataset
from anchorflow_training.dataset import DatasetError

FloatArray = NDArray[np.floating]
Orders = list[FloatArray]
"""Values, first and second derivatives by s, [N, T, 2] each."""

MOST_COUNT = 1 << 20  # beyond it the arrays belong into a file


class SyntheticTrajectoryDataset(TrajectoryDataset):
    """`count` smooth curves from near the origin to a goal some metres away, with exact v and a.

    kind: "bezier" (cubic, random inner control points), "polynomial" (quintic from random end
    states) or "sine" (a straight way with a sine across); same seed, same curves
    """

    def __init__(
        self,
        kind: str = "bezier",
        count: int = 1000,
        *,
        num_steps: int = 64,
        dim: int = 2,
        horizon_s: float = 8.0,
        seed: int = 0,
    ) -> None:
        """dim: 2, or 3 to add the heading of the curve; raises `DatasetError` on others."""
        if kind not in KINDS:
            raise DatasetError(f"kind: expected one of {', '.join(KINDS)}, got {kind!r}")
        if not 1 <= count <= MOST_COUNT:
            raise DatasetError(f"count: expected 1..{MOST_COUNT}, got {count}")
        if dim not in (2, 3):
            raise DatasetError(f"dim: expected 2 or 3, got {dim}")
        s = np.linspace(0.0, 1.0, num_steps)
        orders = KINDS[kind](np.random.default_rng(seed), count, s)
        if dim == 3:
            orders = _with_heading(orders)
        names = "positions", "velocities", "accelerations"
        arrays = {
            name: HeldArray((values / horizon_s**order).astype(np.float32))
            for order, (name, values) in enumerate(zip(names, orders, strict=True))
        }
        self._open(Path(f"synthetic-{kind}"), arrays, horizon_s=horizon_s)


def _goals(rng: np.random.Generator, count: int) -> FloatArray:
    """[N, 2] m, anywhere around."""
    angle, length = rng.uniform(-np.pi, np.pi, count), rng.uniform(2.0, 8.0, count)
    return length[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)


def _from_coefficients(coefficients: FloatArray, s: FloatArray) -> Orders:
    """Polynomials in s, coefficients [N, degree + 1, 2] from the constant up."""
    powers = np.arange(coefficients.shape[1])
    orders = []
    for order in range(3):
        factor = np.prod([np.maximum(powers - k, 0) for k in range(order)], axis=0)
        basis = factor * s[:, None] ** np.maximum(powers - order, 0)
        orders.append(basis @ coefficients)
    return orders


def _bezier(rng: np.random.Generator, count: int, s: FloatArray) -> Orders:
    start, goal = rng.normal(0.0, 0.5, (count, 2)), _goals(rng, count)
    inner = [
        start + share * (goal - start) + rng.normal(0.0, 1.0, (count, 2))
        for share in (1 / 3, 2 / 3)
    ]
    points = np.stack([start, *inner, goal], 1)
    to_powers = np.array([[1, 0, 0, 0], [-3, 3, 0, 0], [3, -6, 3, 0], [-1, 3, -3, 1]], np.float64)
    return _from_coefficients(to_powers @ points, s)


def _polynomial(rng: np.random.Generator, count: int, s: FloatArray) -> Orders:
    start, goal = rng.normal(0.0, 0.5, (count, 2)), _goals(rng, count)
    way = goal - start
    ends = np.stack(
        [
            start,
            way * rng.uniform(0.0, 1.5, (count, 1)) + rng.normal(0.0, 0.5, (count, 2)),
            rng.normal(0.0, 1.0, (count, 2)),
            goal,
            way * rng.uniform(0.0, 1.5, (count, 1)) + rng.normal(0.0, 0.5, (count, 2)),
            np.zeros((count, 2)),
        ],
        1,
    )
    powers = np.arange(6)
    first, second = powers, powers * (powers - 1)
    conditions = np.stack([np.eye(6)[0], np.eye(6)[1], 2 * np.eye(6)[2], np.ones(6), first, second])
    return _from_coefficients(np.linalg.solve(conditions, ends), s)


def _sine(rng: np.random.Generator, count: int, s: FloatArray) -> Orders:
    start, goal = rng.normal(0.0, 0.5, (count, 1, 2)), _goals(rng, count)[:, None]
    way = goal - start
    across = np.stack([-way[..., 1], way[..., 0]], -1) / np.linalg.norm(way, axis=-1)[..., None]
    height = rng.uniform(-1.5, 1.5, (count, 1, 1)) * across
    rate = 2 * np.pi * rng.integers(1, 3, (count, 1, 1)) / 2  # whole half waves
    phase = rate * s[:, None]
    return [
        start + s[:, None] * way + height * np.sin(phase),
        way + height * rate * np.cos(phase),
        -height * rate**2 * np.sin(phase),
    ]


def _with_heading(orders: Orders) -> Orders:
    """The curve's direction beside it; its derivatives follow from a chain rule."""
    _, velocity, acceleration = orders
    squared = np.maximum((velocity**2).sum(-1), 1e-6)
    heading = np.unwrap(np.arctan2(velocity[..., 1], velocity[..., 0]), axis=-1)
    cross = velocity[..., 0] * acceleration[..., 1] - velocity[..., 1] * acceleration[..., 0]
    rate = cross / squared
    turning = np.gradient(rate, 1.0 / (rate.shape[1] - 1), axis=1, edge_order=2)
    columns = heading, rate, turning
    return [np.concatenate([a, b[..., None]], -1) for a, b in zip(orders, columns, strict=True)]


KINDS: dict[str, Callable[[np.random.Generator, int, FloatArray], Orders]] = {
    "bezier": _bezier,
    "polynomial": _polynomial,
    "sine": _sine,
}
