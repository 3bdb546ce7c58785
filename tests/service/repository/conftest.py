"""Tiny bundles of any name and version, whole or broken."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

Write = Callable[..., Path]


@pytest.fixture
def write_bundle(tiny_bundle: Path) -> Write:
    """Copies the tiny bundle to a folder, under a name and a version."""

    def write(folder: Path, *, name: str = "tiny", version: str = "1.2.3") -> Path:
        shutil.copytree(tiny_bundle, folder, dirs_exist_ok=True)
        file = folder / "manifest.json"
        manifest = json.loads(file.read_text()) | {"name": name, "version": version}
        file.write_text(json.dumps(manifest))
        return folder

    return write
