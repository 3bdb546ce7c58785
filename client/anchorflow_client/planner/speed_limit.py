"""How fast the robot drives at most: by its request or, where that does not say, by the card."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from anchorflow_client.contract import CostMapSpec, ModelCard
from anchorflow_client.contract.checks import number, text
from anchorflow_client.contract.ranges import V_MAX
from anchorflow_client.errors import AnchorFlowError
from anchorflow_client.planner.in_flight import AnchorSource


class SpeedLimit:
    """Has the client tell its cards, once for each model that is asked."""

    def __init__(self, client: AnchorSource) -> None:
        self._client = client
        self._cards: tuple[ModelCard, ...] = ()

    def of(self, options: Mapping[str, Any]) -> float:
        """m/s; infinite where no card tells it.

        Raises:
            InvalidRequest: the `v_max` or the `model` among the options is none.
        """
        if (v_max := options.get("v_max")) is not None:
            return number(v_max, "v_max", V_MAX)
        model = options.get("model")
        card = self._card(None if model is None else text(model, "model"))
        own = None if card is None else card.conditioning
        return own.limits.v_max if isinstance(own, CostMapSpec) else math.inf

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
