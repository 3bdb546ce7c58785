"""The engines that a service holds, by the name of their model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard
from anchorflow_client.errors import UnknownModel


class Engine(Protocol):
    """A model that is ready to plan."""

    @property
    def card(self) -> ModelCard:
        """What it is."""
        ...

    def plan(self, request: AnchorRequest, /) -> AnchorBatch:
        """Anchors for every scene of the request. Blocks; several threads may call it.

        Raises:
            RequestError: it cannot honour the request.
        """
        ...


class Engines:
    """Engines by model name, one of them the default."""

    def __init__(self, engines: Mapping[str, Engine], *, default: str) -> None:
        """Raises `ValueError` where the default is not among the engines."""
        if default not in engines:
            raise ValueError(f"the default model {default!r} is none of {sorted(engines)}")
        self._engines = dict(engines)
        self._default = default

    def choose(self, model: str | None) -> Engine:
        """The engine of that model, or the default. Raises `UnknownModel`."""
        name = self._default if model is None else model
        if name not in self._engines:
            served = ", ".join(sorted(self._engines))
            raise UnknownModel(f"expected a model that is served ({served}), got {name!r}", "model")
        return self._engines[name]

    def cards(self) -> list[ModelCard]:
        """All cards, the default model's first."""
        names = sorted(self._engines, key=lambda name: (name != self._default, name))
        return [self._engines[name].card for name in names]
