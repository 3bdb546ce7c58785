"""What tests of commands share."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator

import pytest
from command_line import Served


@pytest.fixture(autouse=True)
def _logging_as_it_was() -> Iterator[None]:
    """A command sets up the logging of its process, which here is that of all tests."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:] = handlers
    root.setLevel(level)


@pytest.fixture
def serve() -> Iterator[Callable[..., Served]]:
    """Start servers, which are killed at the end of the test."""
    started: list[Served] = []

    def start(*options: str, **settings: str) -> Served:
        started.append(Served(*options, **settings))
        return started[-1]

    yield start
    for each in started:
        each.process.kill()
        each.process.communicate(timeout=20)
