"""What tests of several folders share."""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

from anchorflow_benchmarks.programs import free_endpoint

# A deadline judges the machine that a test happens to share, not the code.
settings.register_profile("anchorflow", deadline=None)
settings.load_profile("anchorflow")

# With torch and onnx loaded every look for garbage is long: a hundred times fewer of them.
gc.set_threshold(100_000)

TRACING = ("tests/export/", "tests/test_own_data.py", "tests/service/http/test_planners.py")
"""Tests that trace networks, the longest there are."""

SHARED_DATA = Path(
    os.environ.get(
        "ANCHORFLOW_SHARED_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"
    )
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the longest first, so that no worker ends with them while the other has nothing left."""
    items.sort(key=lambda item: not item.nodeid.startswith(TRACING))


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Finds a file of the shared data folder by its relative path; skips, naming it, if missing.

    The folder is ANCHORFLOW_SHARED_DATA, or ../shared/data beside the checkout.
    """

    def find(name: str) -> Path:
        path = SHARED_DATA / name
        if not path.exists():
            pytest.skip(f"shared data file {name} is not in {SHARED_DATA}")
        return path

    return find


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    """Return the event loop of the tests that are coroutines."""
    return "asyncio"


class Clock:
    """A time that stands still until the test sets it."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    """Return a clock to set."""
    return Clock()


@pytest.fixture
def endpoint() -> str:
    """Return a zenoh endpoint without a listener."""
    return free_endpoint()


@pytest.fixture(scope="session")
def until() -> Callable[[Callable[[], object]], None]:
    """Waits until a condition holds; fails where it still does not after a while.

    For what can only be looked at: where there is an event, wait for the event.
    """
    return _until


def _until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 100
    while not condition():
        assert time.monotonic() < deadline, "it does not come about"
        time.sleep(0.005)
