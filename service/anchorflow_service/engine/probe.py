"""The probe: a request that every model can answer, to find out that a bundle works at all."""

from __future__ import annotations

import numpy as np

from anchorflow_client.contract import AnchorRequest, ModelCard, ResolvedRequest, resolve_for_card

REACH = 0.3
"""Way from start to goal, as a share of what v_max covers in the horizon."""
MARGIN = 2.0
"""Side of the map, in such ways."""
ONE_STEP = {"method": "euler", "schedule": {"uniform": 1}}


def probe_request(card: ModelCard, *, num_samples: int) -> ResolvedRequest:
    """From one side of a free map to the other, in a single step of the flow."""
    way = REACH * card.v_max * card.horizon_s  # m
    rest = np.zeros(2 * card.D)
    start, goal = np.zeros(card.D), np.zeros(card.D)
    start[0], goal[0] = -way / 2, way / 2
    request = AnchorRequest.build(
        cost_map={
            "data": np.zeros((1, card.map.H, card.map.W), np.float32),
            "resolution": MARGIN * way / min(card.map.H, card.map.W),
        },
        x_curr=[*start, *rest],
        x_goal=[*goal, *rest[: card.D]],
        num_samples=num_samples,
        seed=0,
        sampler=ONE_STEP,
    )
    return resolve_for_card(request, card)
