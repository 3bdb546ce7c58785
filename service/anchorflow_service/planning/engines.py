"""The engines of a service, by the name of their model."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Protocol

from anchorflow_client.contract import AnchorBatch, ModelCard, ResolvedRequest
from anchorflow_client.errors import UnknownModel


class PlanningEngine(Protocol):
    """A loaded model."""

    @property
    def card(self) -> ModelCard:
        """Return the model's card."""
        ...

    def plan(
        self, request: ResolvedRequest, /, *, threads: int, check: Callable[[], object]
    ) -> AnchorBatch:
        """Plan anchors for every scene of a request resolved for the card. Blocks; thread-safe.

        The answer depends neither on `threads`, the number of threads it may use, nor on other
        requests. `check` is called between steps; its exceptions end the work.

        Raises:
            RequestError: the engine cannot honour the request.
        """
        ...


class EngineRegistry:
    """Engines by model name, one of them the default; they may change while requests arrive.

    A request keeps the engine that it chose, so that a change fails no request.
    """

    def __init__(self, engines: Mapping[str, PlanningEngine], *, default: str) -> None:
        """Raises `ValueError` if the default is not among the engines."""
        if default not in engines:
            raise ValueError(f"the default model {default!r} is none of {sorted(engines)}")
        # Replaced as a whole, never modified, so that reading needs no lock.
        self._engines = dict(engines)
        self.default = default
        """Used if a request names no model; it may have been removed."""
        self._changing = threading.Lock()
        self._followers: list[Callable[[], None]] = []

    def choose(self, model: str | None) -> PlanningEngine:
        """Return the engine of that model, or the default. Raises `UnknownModel`."""
        name = self.default if model is None else model
        engine = self._engines.get(name)
        if engine is None:
            served = ", ".join(sorted(self._engines)) or "none at present"
            which = f"the default, {name!r}" if model is None else repr(name)
            raise UnknownModel(f"expected a model that is served ({served}), got {which}", "model")
        return engine

    def put(self, engine: PlanningEngine) -> None:
        """Serve the engine under the model name of its card."""
        with self._changing:
            self._engines = {**self._engines, engine.card.name: engine}
        self._notify()

    def remove(self, model: str) -> None:
        """Stop serving that model. Raises `UnknownModel`."""
        with self._changing:
            self.choose(model)
            self._engines = {name: each for name, each in self._engines.items() if name != model}
        self._notify()

    @contextmanager
    def followed_by(self, follower: Callable[[], None]) -> Iterator[None]:
        """Call the follower after every change inside the block, on the thread of the change."""
        self._followers.append(follower)
        try:
            yield
        finally:
            self._followers.remove(follower)

    def cards(self) -> list[ModelCard]:
        """Return all cards, the default model's first."""
        engines = self._engines
        names = sorted(engines, key=lambda name: (name != self.default, name))
        return [engines[name].card for name in names]

    def _notify(self) -> None:
        for follower in list(self._followers):
            follower()
