"""The soak reads what a process really holds."""

from __future__ import annotations

import mmap
import os
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.linux_processes import MB, Held
from anchorflow_benchmarks.soak import SoakConfig, soak_table
from anchorflow_client.contract import AnchorRequest, ModelId

CONFIG = SoakConfig(requests=8, warm_up=2, readings=4)


def soak(happens: Callable[[], object]) -> list[dict]:
    """The rows of a soak of this process, in which this happens at every request."""

    def ask(_: AnchorRequest) -> Any:
        happens()
        return SimpleNamespace(model=ModelId("stub", "1", "0"))

    requests: Any = ["request"]
    table = soak_table(lambda _: ask, os.getpid(), requests, CONFIG)
    return [dict(row) for row in table.rows]


def test_a_leak_shows() -> None:
    kept = []

    def leak() -> None:
        pages = mmap.mmap(-1, int(8 * MB))  # the allocator may have as much to spare
        pages.write(b"x" * len(pages))
        kept.append(pages)

    rows = soak(leak)
    for pages in kept:
        pages.close()
    assert [row["requests"] for row in rows] == [0, 2, 4, 6, 8]
    assert 60 < rows[-1]["grown by MB"] < 80


def test_an_open_descriptor_shows() -> None:
    opened = []
    rows = soak(lambda: opened.append(os.dup(0)))
    for descriptor in opened:
        os.close(descriptor)
    assert rows[-1]["descriptors"] == rows[0]["descriptors"] + 8


def test_a_process_that_is_gone_is_named() -> None:
    with pytest.raises(BenchmarkError, match="process 999999999"):
        Held.by(999_999_999)
