"""What a transport adds: the same requests in this process, over HTTP and over zenoh, by turns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import cycle
from time import perf_counter

from anchorflow_benchmarks.clients import Ask
from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_benchmarks.turns import p50, p99, spare_the_collector, take_turns
from anchorflow_client.contract import AnchorRequest

ENGINE_STAGES = ("encode", "sample", "refine")
IN_PROCESS = "in-process"


def transport_table(
    ways: dict[str, Ask],
    requests: Sequence[AnchorRequest],
    *,
    rounds: int,
    budget_s: float,
) -> ResultTable:
    """Round trips of each way, and what remains of them without the engine's own stages.

    Args:
        ways: how to ask, by name; one of them is `IN_PROCESS`.
        requests: asked in turn.
        rounds, budget_s: as `take_turns` takes them.
    """
    beside: dict[str, list[float]] = {name: [] for name in ways}
    calls = {name: _timed(ask, requests, beside[name]) for name, ask in ways.items()}
    with spare_the_collector():
        times = take_turns(calls, rounds=rounds, budget_s=budget_s)
    # The first call of each is not counted: caches and connections.
    spare = {name: p50(values[1:]) for name, values in beside.items()}
    rows: list[Row] = [
        {
            "way": name,
            "p50 ms": p50(values),
            "p99 ms": p99(values),
            "p50 - in-process p50 ms": p50(values) - p50(times[IN_PROCESS]),
            "beside the engine p50 ms": spare[name],
            "added p50 ms": spare[name] - spare[IN_PROCESS],
            "requests": len(values),
        }
        for name, values in times.items()
    ]
    note = (
        "beside the engine: the round trip without the encode, sample and refine that the answer "
        "tells; added: that, less the same in-process"
    )
    return ResultTable("What a transport adds", rows, note)


def _timed(ask: Ask, requests: Sequence[AnchorRequest], beside: list[float]) -> Callable[[], None]:
    ahead = cycle(requests)

    def call() -> None:
        request = next(ahead)
        start = perf_counter()
        timing_ms = ask(request).timing_ms
        round_trip_ms = (perf_counter() - start) * 1e3
        beside.append(round_trip_ms - sum(timing_ms[stage] for stage in ENGINE_STAGES))

    return call
