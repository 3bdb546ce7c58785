"""Tiny bundles of any name and version, whole or broken."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from written_graphs import set_in_manifest

Write = Callable[..., Path]


@pytest.fixture
def write_bundle(tiny_bundle: Path) -> Write:
    """Copies the tiny bundle to a folder, under a name and a version."""

    def write(folder: Path, *, name: str = "tiny", version: str = "1.2.3") -> Path:
        shutil.copytree(tiny_bundle, folder, dirs_exist_ok=True)
        set_in_manifest(folder, "name", to=name)
        set_in_manifest(folder, "version", to=version)
        return folder

    return write
