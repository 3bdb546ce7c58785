"""Time calls in alternation, so that noise of the machine affects all of them."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from random import Random
from time import perf_counter, sleep

import numpy as np

MIN_ROUNDS = 3
SEED = 0


def take_turns(
    calls: Mapping[str, Callable[[], object]], *, rounds: int, budget_s: float, rest_s: float = 0.0
) -> dict[str, list[float]]:
    """Return the times in ms of each call by its name, after one warm-up call.

    Each round has a random order, because a call affects the caches of the next one. A call that
    has used `budget_s` rests after MIN_ROUNDS. `rest_s` is the pause before each call.
    """
    times: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    order, shuffled = list(calls.items()), Random(SEED)
    for _ in range(rounds):
        shuffled.shuffle(order)
        for name, call in order:
            spent = times[name]
            if len(spent) >= MIN_ROUNDS and sum(spent) > budget_s * 1e3:
                continue
            sleep(rest_s)
            start = perf_counter()
            call()
            spent.append((perf_counter() - start) * 1e3)
    return times


@contextmanager
def spare_the_collector() -> Iterator[None]:
    """Hide all objects so far from the garbage collector, which slows the timing of clients.

    They are unfrozen at the end: bindings that count references warn of objects left at exit.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def p50(values: list[float]) -> float:
    return float(np.median(values))


def p99(values: list[float]) -> float:
    """Return the 99th percentile; nearly the largest of fewer than a hundred values."""
    return float(np.percentile(values, 99))
