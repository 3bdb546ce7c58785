"""Timing by turns: contenders alternate, so that a noisy machine is noisy for all of them."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from random import Random
from time import perf_counter, sleep

import numpy as np

LEAST = 3  # timed calls of each contender, however slow it is
SEED = 0  # of the orders


def take_turns(
    calls: Mapping[str, Callable[[], object]], *, rounds: int, budget_s: float, rest_s: float = 0.0
) -> dict[str, list[float]]:
    """Times [ms] of each call by its name, after one that is not counted.

    Each round has an order of its own: whoever always came after the same one would find the caches
    as that one leaves them. A call that has used up `budget_s` leaves the round, but not before its
    third turn. Before each the machine rests for `rest_s`, so that nobody is timed beside the idle
    threads of another.
    """
    times: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    order, shuffled = list(calls.items()), Random(SEED)
    for _ in range(rounds):
        shuffled.shuffle(order)
        for name, call in order:
            spent = times[name]
            if len(spent) >= LEAST and sum(spent) > budget_s * 1e3:
                continue
            sleep(rest_s)
            start = perf_counter()
            call()
            spent.append((perf_counter() - start) * 1e3)
    return times


@contextmanager
def spare_the_collector() -> Iterator[None]:
    """Within it the garbage collector does not look at what was imported and made before.

    For timings of a client, which does not have to carry a benchmark's own modules. What stayed
    frozen would outlive the interpreter, and bindings that count their references say so.
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
    """The 99th percentile; of fewer than a hundred values, nearly the largest."""
    return float(np.percentile(values, 99))
