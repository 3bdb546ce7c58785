"""Soft costs bend ways in every style, and corridors of one or two cells are passable."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from asked_engine import plan

from anchorflow_client.contract import AnchorBatch, AnchorRequest
from anchorflow_client.contract.fields import STYLES
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine

CELL, SIDE = 0.1, 128
PATCH = np.array([1.5, 1.6])  # m, half its sides


@pytest.fixture(scope="module")
def engine() -> Engine:
    return Engine(load_bundle(DEFAULT_BUNDLE), threads=2)


def patch() -> np.ndarray:
    """[H, W], 1 in a patch of 3 x 3.2 m across the straight way."""
    y, x = (np.indices((SIDE, SIDE)) + 0.5 - SIDE / 2) * CELL
    return ((np.abs(x) < PATCH[0]) & (np.abs(y) < PATCH[1])).astype(np.float32)


def layers(kind: str) -> np.ndarray:
    """[C, H, W], the patch told in one of the ways that there are."""
    even = np.zeros((4, SIDE, SIDE), np.float32)
    even[1] = 1.0
    channel = {"occupancy": 0, "traversability": 1, "risk": 2, "further": 3}[kind]
    even[channel] = {"occupancy": 0.45 * patch(), "traversability": 1.0 - patch()}.get(
        kind, patch()
    )
    return even[: channel + 1]


def crossed(engine: Engine, kind: str, **changes: Any) -> AnchorBatch:
    request = {
        "cost_map": {"data": layers(kind), "resolution": CELL},
        "x_curr": [-4.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        "x_goal": [4.0, 0.0, 0.0, 0.0],
        "robot_radius": 0.22,
        "seed": 1,
    }
    return plan(engine, AnchorRequest.build(**(request | changes)))


def share_inside(paths: np.ndarray) -> np.ndarray:
    """[N], the share of the samples [N, T, 2] that lie in the patch, but for a cell at its edge."""
    return (np.abs(paths) < PATCH - CELL).all(-1).mean(-1)


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("kind", ["occupancy", "traversability", "risk", "further"])
def test_the_best_goes_round_a_dear_patch_and_others_on_its_other_side(
    engine: Engine, kind: str, style: str
) -> None:
    anchors = crossed(engine, kind, w_style=style)
    assert anchors.safe is not None
    assert anchors.safe.all()
    assert share_inside(anchors.trajectories)[anchors.best] == 0.0
    round_it = anchors.trajectories[share_inside(anchors.trajectories) < 0.05]
    assert (round_it[:, 32, 1] > PATCH[1] - CELL).sum() >= 1
    assert (round_it[:, 32, 1] < CELL - PATCH[1]).sum() >= 1


def test_a_penalty_of_zero_or_a_weight_of_zero_leads_straight_through(engine: Engine) -> None:
    free = crossed(engine, "risk", cost_penalty=0.0)
    cost_map = {"data": layers("risk"), "resolution": CELL, "channel_weights": [1.0, 0.0]}
    unweighted = crossed(engine, "risk", cost_map=cost_map)

    for anchors in (free, unweighted):
        assert share_inside(anchors.trajectories).mean() > 0.2
    np.testing.assert_array_equal(free.trajectories, unweighted.trajectories)


@pytest.mark.parametrize("radius", [0.2, 0.3])
@pytest.mark.parametrize("cell", [1.0, 0.5, 0.25, 0.125])
def test_a_corridor_of_one_metre_is_passed_at_any_resolution(
    engine: Engine, cell: float, radius: float
) -> None:
    """A corridor with two corners, drawn with cells of 1 m and told in finer ones."""
    coarse = np.ones((16, 16), np.float32)
    coarse[5, 1:8] = coarse[5:11, 8] = coarse[10, 8:15] = 0.0
    parts = round(1.0 / cell)
    data = coarse.repeat(parts, 0).repeat(parts, 1)[None]

    anchors = plan(
        engine,
        AnchorRequest.build(
            cost_map={"data": data, "resolution": cell, "origin": [0.0, 0.0]},
            x_curr=[1.5, 5.5, 0.0, 0.0, 0.0, 0.0],
            x_goal=[14.5, 10.5, 0.0, 0.0],
            robot_radius=radius,
            seed=1,
        ),
    )

    assert anchors.safe is not None
    assert anchors.safe.all()
