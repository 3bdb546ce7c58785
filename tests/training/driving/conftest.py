"""Logs of two made-up bends, for each file of tests its own: some damage what is cached beside."""

from __future__ import annotations

from pathlib import Path

import pytest
from driven_bend import write_bends

from anchorflow_training.driving.windows import DrivingWindows, open_windows


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bends(tmp_path_factory.mktemp("bends"), count=2)


@pytest.fixture(scope="module")
def windows(folder: Path) -> DrivingWindows:
    return open_windows(folder)
