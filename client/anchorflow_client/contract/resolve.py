"""A request meets a model card: what is open is filled, what cannot be honoured is refused."""

from __future__ import annotations

import math
import secrets
from dataclasses import dataclass, field
from typing import Any

from anchorflow_client.contract import ranges
from anchorflow_client.contract.arrays import vector_shape
from anchorflow_client.contract.card import ModelCard
from anchorflow_client.contract.request import LIMIT_INTERVALS, AnchorRequest
from anchorflow_client.contract.sampling import (
    RefineChoice,
    RefineSpec,
    SamplerChoice,
    SamplerSpec,
)
from anchorflow_client.errors import InvalidRequest

DRAWN_SEED_BITS = 53
"""Few enough for every JSON reader to echo a drawn seed exactly, JavaScript's included."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ResolvedRequest(AnchorRequest):
    """A request in which nothing is left to the card."""

    robot_radius: float = field()
    v_max: float = field()
    a_max: float = field()
    horizon_s: float = field()
    model: str = field()
    seed: int = field()
    sampler: SamplerSpec = field()
    refine: RefineSpec = field()


def resolve_for_card(request: AnchorRequest, card: ModelCard) -> ResolvedRequest:
    """Complete a request by a card's defaults; a resolved request comes back unchanged.

    A seed is drawn where none is given.

    Raises:
        InvalidRequest: x_curr has another D than the card; robot_radius, v_max, a_max or horizon_s
            differs from the card's, and the card does not list it as adjustable.
    """
    _check_dim(request, card)
    filled: dict[str, Any] = {name: _limit(name, request, card) for name in LIMIT_INTERVALS} | {
        "model": request.model or card.name,
        "seed": secrets.randbits(DRAWN_SEED_BITS) if request.seed is None else request.seed,
        "sampler": (request.sampler or SamplerChoice()).over(card.sampler),
        "refine": (request.refine or RefineChoice()).over(card.refine),
    }
    return ResolvedRequest(**(request.field_values() | filled))


def _check_dim(request: AnchorRequest, card: ModelCard) -> None:
    if request.dim == card.D:
        return
    size = request.x_curr.shape[1]
    got = f"[{request.num_scenes},{size}]" if request.batched else f"[{size}]"
    shape = vector_shape(ranges.STATE_FIELDS * card.D)
    expected = f"expected shape {shape}, as {card.name} {card.version} has D = {card.D}"
    raise InvalidRequest(f"{expected}, got {got}", "x_curr")


def _limit(name: str, request: AnchorRequest, card: ModelCard) -> float:
    own, asked = getattr(card, name), getattr(request, name)
    # Callers keep limits in float32: 0.3 must not be refused as 0.30000001.
    if asked is None or math.isclose(asked, own, rel_tol=1e-6):
        return own
    if name in card.adjustable:
        return asked
    unit = LIMIT_INTERVALS[name].unit
    expected = f"expected {own:g} {unit}, which {card.name} {card.version} was made for"
    raise InvalidRequest(f"{expected} and its card does not let change, got {asked:g}", name)
