"""How fast and how wide the robot is: by its request or, where that does not say, by the card."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from anchorflow_client.contract import CostMapSpec, ModelCard
from anchorflow_client.contract.checks import number, text
from anchorflow_client.contract.ranges import ROBOT_RADIUS, V_MAX
from anchorflow_client.errors import AnchorFlowError
from anchorflow_client.planner.in_flight import AnchorSource


class RobotLimits(NamedTuple):
    """v_max: m/s, infinite where nothing tells it; radius: m, None where nothing tells it."""

    v_max: float
    radius: float | None


class LimitsSource:
    """Has the client tell its cards, once for each model that is asked."""

    def __init__(self, client: AnchorSource) -> None:
        self._client = client
        self._cards: tuple[ModelCard, ...] = ()

    def of(self, options: Mapping[str, Any]) -> RobotLimits:
        """Those that hold for a request with these options.

        Raises:
            InvalidRequest: the `v_max`, `robot_radius` or `model` among the options is none.
        """
        v_max, radius = options.get("v_max"), options.get("robot_radius")
        v_max = None if v_max is None else number(v_max, "v_max", V_MAX)
        radius = None if radius is None else number(radius, "robot_radius", ROBOT_RADIUS)
        if v_max is None or radius is None:
            model = options.get("model")
            card = self._card(None if model is None else text(model, "model"))
            if card is not None and isinstance(card.conditioning, CostMapSpec):
                own = card.conditioning.limits
                v_max = own.v_max if v_max is None else v_max
                radius = own.robot_radius if radius is None else radius
        return RobotLimits(math.inf if v_max is None else v_max, radius)

    def _card(self, model: str | None) -> ModelCard | None:
        if (known := _named(model, self._cards)) is not None:
            return known
        if models := getattr(self._client, "models", None):
            try:
                self._cards = models()
            except AnchorFlowError:  # the request that follows can do without, or tells why
                return None
        return _named(model, self._cards)


def _named(model: str | None, cards: tuple[ModelCard, ...]) -> ModelCard | None:
    """The card of that name, the first for None."""
    return next((card for card in cards if model in (None, card.name)), None)
