"""The engines that a service holds, by the name of their model."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Protocol

from anchorflow_client.contract import AnchorBatch, ModelCard, ResolvedRequest
from anchorflow_client.errors import UnknownModel


class PlanningEngine(Protocol):
    """A model that is ready to plan."""

    @property
    def card(self) -> ModelCard:
        """What it is."""
        ...

    def plan(
        self, request: ResolvedRequest, /, *, threads: int, check: Callable[[], object]
    ) -> AnchorBatch:
        """Anchors for every scene of a request that is resolved for the card. Blocks; several
        threads may call it.

        The answer depends neither on `threads`, which it may keep busy, nor on what else is
        planned. `check` is called between steps; what it raises ends the work.

        Raises:
            RequestError: it cannot honour the request.
        """
        ...


class EngineRegistry:
    """Engines by model name, one of them the default; they may change while requests come.

    A request keeps the engine that it was given, so that a change fails none.
    """

    def __init__(self, engines: Mapping[str, PlanningEngine], *, default: str) -> None:
        """Raises `ValueError` where the default is not among the engines."""
        if default not in engines:
            raise ValueError(f"the default model {default!r} is none of {sorted(engines)}")
        # Replaced as a whole, never changed: who reads needs no lock.
        self._engines = dict(engines)
        self.default = default
        """Answers where no model is named; it may be taken out meanwhile."""
        self._changing = threading.Lock()
        self._followers: list[Callable[[], None]] = []

    def choose(self, model: str | None) -> PlanningEngine:
        """The engine of that model, or the default. Raises `UnknownModel`."""
        name = self.default if model is None else model
        engine = self._engines.get(name)
        if engine is None:
            served = ", ".join(sorted(self._engines)) or "none at present"
            which = f"the default, {name!r}" if model is None else repr(name)
            raise UnknownModel(f"expected a model that is served ({served}), got {which}", "model")
        return engine

    def put(self, engine: PlanningEngine) -> None:
        """From now on this engine answers for the model of its card."""
        with self._changing:
            self._engines = {**self._engines, engine.card.name: engine}
        self._tell()

    def remove(self, model: str) -> None:
        """From now on nobody answers for that model. Raises `UnknownModel`."""
        with self._changing:
            self.choose(model)
            self._engines = {name: each for name, each in self._engines.items() if name != model}
        self._tell()

    @contextmanager
    def followed_by(self, follower: Callable[[], None]) -> Iterator[None]:
        """Calls it after every change inside the block, on the thread that changed the engines."""
        self._followers.append(follower)
        try:
            yield
        finally:
            self._followers.remove(follower)

    def cards(self) -> list[ModelCard]:
        """All cards, the default model's first."""
        engines = self._engines
        names = sorted(engines, key=lambda name: (name != self.default, name))
        return [engines[name].card for name in names]

    def _tell(self) -> None:
        for follower in list(self._followers):
            follower()
