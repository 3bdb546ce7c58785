"""Lookup of a trajectory's car in the BEV."""

from __future__ import annotations

import math

import torch

from anchorflow_models.transfuser import placed


def places_of(x: float, y: float, heading: float) -> list[list[float]]:
    """Places of the car of one pose: its middle, and 3 m ahead and 1 m to its left."""
    return placed(torch.tensor([x, y, heading]), torch.tensor([(0.0, 0.0), (3.0, 1.0)])).tolist()


def test_places_turn_with_the_car() -> None:
    assert places_of(10.0, 2.0, 0.0) == [[10.0, 2.0], [13.0, 3.0]]
    (x, y) = places_of(10.0, 2.0, math.pi / 2)[1]
    assert math.isclose(x, 9.0, abs_tol=1e-5)
    assert math.isclose(y, 5.0, abs_tol=1e-5)
