"""Levels of load, of callables that stand for servers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from anchorflow_benchmarks.clients import Connect
from anchorflow_benchmarks.load import LoadConfig, load_table, run_level
from anchorflow_client.contract import ModelId
from anchorflow_client.errors import Overloaded

REQUESTS: Any = ["first", "second"]


def server(*, refuse: int = 0) -> Connect:
    """Answers at once, and refuses every `refuse`-th request."""
    asked: list[str] = []

    def ask(request: Any) -> Any:
        asked.append(request)
        if refuse and len(asked) % refuse == 0:
            raise Overloaded("too many", retry_after_s=0.0)
        return SimpleNamespace(model=ModelId("stub", "1", "0"))

    return lambda _: ask


def test_a_level_tells_what_came_of_its_requests() -> None:
    # The first goes ahead and is not counted.
    row = run_level(server(refuse=5), 1, REQUESTS, LoadConfig(seconds=60, requests=19))

    assert (row["requests"], row["errors"], row["error codes"]) == (15, 4, "overloaded 4")
    assert float(row["p99 ms"] or 0) >= float(row["p50 ms"] or 0) > 0
    assert float(row["per second"] or 0) > 0


def test_a_row_for_each_way_and_number_of_clients() -> None:
    ways: dict[str, Connect] = {"a": server(), "b": server()}
    table = load_table(ways, REQUESTS, LoadConfig(clients=(1, 2), seconds=60, requests=4))

    assert [(row["way"], row["clients"], row["requests"]) for row in table.rows] == [
        ("a", 1, 4),
        ("b", 1, 4),
        ("a", 2, 4),
        ("b", 2, 4),
    ]
