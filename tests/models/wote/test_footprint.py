"""What lies under an anchor's car."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from tiny_wote import TINY, sensors, tiny_wote

from anchorflow_models.transfuser import placed


@torch.no_grad()
def test_rewards_heed_what_lies_under_an_anchor_and_nothing_beside() -> None:
    model = tiny_wote()
    context = model.encode(**sensors(B=1))
    bev, ego, fine = (context[name] for name in model.context_for_score)
    poses = torch.zeros(1, TINY.anchors, 8, 3)
    poses[:, 6:, :, 0] = -20.0  # half of the cars are behind

    def foretold(fine: torch.Tensor) -> torch.Tensor:
        judged = model.judge(bev, model.move(bev, ego), fine=fine, poses=poses)
        return torch.cat([judged.simulation, judged.imitation[..., None]], -1)[0]

    changed = fine.clone()
    changed[:, :5] += 1.0  # rows ahead of the ego and about it; reach is 32 m in 8 rows
    same = (foretold(changed) == foretold(fine)).all(-1)
    assert same.tolist() == [False] * 6 + [True] * 6


@torch.no_grad()
def test_the_published_network_has_none() -> None:
    model = tiny_wote(replace(TINY, footprint=()))
    context = model.encode(**sensors())
    assert "bev_fine" not in context
    assert model.context_for_score == ("bev_tokens", "ego")
    assert model.score(context["bev_tokens"], context["ego"])["scores"].shape == (2, 12)
    assert not any("footprint" in name for name, _ in model.named_parameters())


@torch.no_grad()
def test_nothing_to_look_up_is_an_error() -> None:
    model = tiny_wote()
    context = model.encode(**sensors())
    with pytest.raises(ValueError, match="fine: expected"):
        model.score(context["bev_tokens"], context["ego"])


def places_of(x: float, y: float, heading: float) -> list[list[float]]:
    """Places of the car of one pose: its middle, and 3 m ahead and 1 m to its left."""
    return placed(torch.tensor([x, y, heading]), torch.tensor([(0.0, 0.0), (3.0, 1.0)])).tolist()


def test_places_turn_with_the_car() -> None:
    assert places_of(10.0, 2.0, 0.0) == [[10.0, 2.0], [13.0, 3.0]]
    (x, y) = places_of(10.0, 2.0, math.pi / 2)[1]
    assert math.isclose(x, 9.0, abs_tol=1e-5)
    assert math.isclose(y, 5.0, abs_tol=1e-5)
