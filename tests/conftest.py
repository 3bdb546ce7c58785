"""What tests of several folders share."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

# A deadline judges the machine that a test happens to share, not the code.
settings.register_profile("anchorflow", deadline=None)
settings.load_profile("anchorflow")

SHARED_DATA = Path(
    os.environ.get(
        "ANCHORFLOW_SHARED_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"
    )
)


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
