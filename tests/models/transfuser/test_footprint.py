"""Where a trajectory's car is looked up in the BEV."""

from __future__ import annotations

import math

import torch

from anchorflow_models.transfuser import driven_by_car, placed


def places_of(x: float, y: float, heading: float) -> list[list[float]]:
    """Where the car of one pose is looked up: its middle, and 3 m ahead and 1 m to its left."""
    return placed(torch.tensor([x, y, heading]), torch.tensor([(0.0, 0.0), (3.0, 1.0)])).tolist()


def test_places_turn_with_the_car() -> None:
    assert places_of(10.0, 2.0, 0.0) == [[10.0, 2.0], [13.0, 3.0]]
    (x, y) = places_of(10.0, 2.0, math.pi / 2)[1]
    assert math.isclose(x, 9.0, abs_tol=1e-5)
    assert math.isclose(y, 5.0, abs_tol=1e-5)


def test_a_car_that_is_told_to_stand_brakes_first() -> None:
    motion = torch.tensor([[0.0, 0.0, 0.0, 0.0], [8.0, 0.0, 0.0, 0.0]])
    resting, braking = driven_by_car(torch.zeros(2, 1, 8, 3), motion, dt=0.5)[:, 0, -1]
    assert resting.abs().max() < 1e-3
    assert 5.0 < braking[0] < 15.0


def test_a_car_that_turns_now_goes_on_turning() -> None:
    straight = torch.zeros(1, 1, 8, 3)
    straight[..., 0] = 4.0 * torch.arange(1, 9)
    motion = torch.tensor([[8.0, 0.0, 0.0, 3.0]])  # to the left
    assert driven_by_car(straight, motion, dt=0.5)[0, 0, 1, 1] > 0.3
