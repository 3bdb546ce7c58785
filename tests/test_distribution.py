"""The client depends on numpy alone, and on one more package for zenoh."""

from __future__ import annotations

import re
import subprocess
from importlib.metadata import requires
from pathlib import Path

import pytest
from hatchling.metadata.core import ProjectMetadata
from hatchling.plugin.manager import PluginManager

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def project() -> ProjectMetadata:
    """Read the metadata of this folder."""
    return ProjectMetadata(str(ROOT), PluginManager())


def names(requirements: list[str]) -> list[str]:
    return [re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in requirements]


def test_the_client_needs_numpy_alone(project: ProjectMetadata) -> None:
    assert names(project.core.dependencies) == ["numpy"]


def test_zenoh_is_one_package_more(project: ProjectMetadata) -> None:
    assert names(project.core.optional_dependencies["zenoh"]) == ["eclipse-zenoh"]


@pytest.mark.parametrize("name", ["numpy", "eclipse-zenoh"])
def test_neither_brings_another(name: str) -> None:
    assert not [line for line in requires(name) or [] if "extra ==" not in line]


def test_every_extra_that_a_text_names_exists(project: ProjectMetadata) -> None:
    texts = subprocess.run(
        ["git", "grep", "-hoE", r"pip install [^`]*\[[a-z,]+\]", "--", "*.py", "*.md", "Makefile"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    named = {extra for group in re.findall(r"\[([a-z,]+)\]", texts) for extra in group.split(",")}
    assert named
    assert named <= set(project.core.optional_dependencies)
    assert not re.findall(r"pip install '?\.\[", texts)  # would replace an editable install
