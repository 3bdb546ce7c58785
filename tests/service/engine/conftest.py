"""Engines over the bundle that is worked out by hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine


@pytest.fixture
def engine(tiny_bundle: Path) -> Engine:
    """Over the bundle that is worked out by hand."""
    return Engine(load_bundle(tiny_bundle), threads=2)


@pytest.fixture
def free(free_bundle: Path) -> Engine:
    """Its anchors have their own durations."""
    return Engine(load_bundle(free_bundle), threads=2)
