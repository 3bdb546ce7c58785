"""What is installed: the robot's distributions, the wheels, and the extras that texts name."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import sysconfig
import tarfile
from collections.abc import Sequence
from importlib.metadata import requires
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder
from hatchling.metadata.core import ProjectMetadata
from hatchling.plugin.manager import PluginManager

import anchorflow_client
from anchorflow_cli.main import COMMANDS

ROOT = Path(__file__).resolve().parents[1]
ROBOT = ("client", "trajectory", "control")
"""Folders of the distributions for a robot, whose packages the top one contains too."""
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
SERVICE = "from anchorflow_service.bundle import *; print(load_bundle(DEFAULT_BUNDLE).path)"
ALONE = (
    "import anchorflow_client, anchorflow_control, importlib.util as find; "
    "from anchorflow_client import AnchorClient, ZenohAnchorClient; "
    "assert find.find_spec('anchorflow_service') is None; print(anchorflow_client.__file__)"
)


def metadata(folder: Path) -> ProjectMetadata:
    return ProjectMetadata(str(folder), PluginManager())


def text_of(command: Sequence[str | Path], *, folder: Path) -> str:
    """Return what a command prints; this checkout is not on its path."""
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


def environment(folder: Path, *install: str | Path) -> Path:
    """Make an environment with these installed, and only libraries of this one; return `bin`."""
    text_of([sys.executable, "-m", "venv", "--without-pip", folder], folder=ROOT)
    (site,) = folder.glob("lib/python*/site-packages")
    # Files there are found, but the .pth files of editable installs are not read.
    (site / "libraries.pth").write_text(sysconfig.get_path("purelib"))
    options = (
        "--python",
        folder / "bin" / "python",
        "install",
        "--no-deps",
        "--no-index",
        "--no-compile",
    )
    text_of([*PIP, *options, "--no-build-isolation", "--ignore-installed", *install], folder=ROOT)
    return folder / "bin"


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Build each folder's sdist, and its wheel from that; return the wheels by folder."""
    out = tmp_path_factory.mktemp("dist")
    for folder in ("", *ROBOT):
        (archive,) = SdistBuilder(str(ROOT / folder)).build(directory=str(out))
        with tarfile.open(archive) as opened:
            opened.extractall(out, filter="data")
        (_,) = WheelBuilder(archive.removesuffix(".tar.gz")).build(directory=str(out))
    version = anchorflow_client.__version__
    names = {"": "anchorflow", **{folder: f"anchorflow_{folder}" for folder in ROBOT}}
    return {key: out / f"{name}-{version}-py3-none-any.whl" for key, name in names.items()}


@pytest.mark.parametrize(
    ("folders", "program"),
    [(("",), SERVICE), (ROBOT, ALONE)],
    ids=["service", "robot"],
)
def test_wheels_run_without_a_checkout(
    folders: tuple[str, ...], program: str, wheels: dict[str, Path], tmp_path: Path
) -> None:
    programs = environment(tmp_path / "env", *(wheels[folder] for folder in folders))
    (empty := tmp_path / "empty").mkdir()
    said = text_of([programs / "python", "-c", program], folder=empty)
    assert said.startswith(str(tmp_path))
    if "" in folders:
        version = text_of([programs / "anchorflow", "--version"], folder=empty)
        assert version == f"anchorflow {anchorflow_client.__version__}\n"
        assert "--goal" in text_of([programs / "anchorflow", "plan", "--help"], folder=empty)


def test_both_editable_are_one_folder(tmp_path: Path) -> None:
    programs = environment(tmp_path / "env", "-e", ".", "-e", "./client")
    where = [programs / "python", "-c", "import anchorflow_client as c; print(c.__path__[0])"]
    remove = [*PIP, "--python", programs / "python", "uninstall", "--yes", "anchorflow-client"]
    folder = f"{ROOT / 'client' / 'anchorflow_client'}\n"

    assert text_of(where, folder=tmp_path) == folder
    text_of(remove, folder=tmp_path)
    assert text_of(where, folder=tmp_path) == folder


def test_a_robot_needs_numpy_and_what_the_extras_name() -> None:
    top = metadata(ROOT).core
    client, trajectory, control = (metadata(ROOT / folder).core for folder in ROBOT)
    loops = [*top.optional_dependencies["control"], *top.dependencies]

    assert client.dependencies == top.dependencies == ["numpy>=1.26"]
    assert client.optional_dependencies == {"zenoh": top.optional_dependencies["zenoh"]}
    assert client.optional_dependencies["zenoh"][0].startswith("eclipse-zenoh>")
    assert trajectory.dependencies == loops
    assert control.dependencies == ["anchorflow-client", "anchorflow-trajectory", *loops]


def test_version_and_licence_are_those_of_the_top() -> None:
    version = anchorflow_client.__version__
    package = ElementTree.parse(ROOT / "ros" / "package.xml")

    assert {metadata(ROOT / folder).version for folder in ("", *ROBOT)} == {version}
    assert package.findtext("version") == version
    for folder in ROBOT:
        assert (ROOT / folder / "LICENSE").read_text() == (ROOT / "LICENSE").read_text()


@pytest.mark.parametrize("name", ["numpy", "eclipse-zenoh"])
def test_neither_brings_another(name: str) -> None:
    assert not [line for line in requires(name) or [] if "extra ==" not in line]


def test_every_extra_that_a_text_names_exists() -> None:
    pattern = r"(pip|PIP\)) install .*|(needs_extra|how_to_install)\(['\"].*"
    command = ["git", "grep", "-hoE", pattern, "--", "*.py", "*.md", "*.sh", "Makefile"]
    texts = text_of(command, folder=ROOT)
    named = set(re.findall(r"(?:needs_extra|how_to_install)\(['\"](\w+)", texts))
    named |= {command.extra for command in COMMANDS.values()}
    groups = re.findall(r"(?:\.|anchorflow|whl)\[([a-z$()A-Z,]+)\]", texts)
    named |= {extra for group in groups for extra in re.split(r",|\$\(COMMA\)", group)}

    assert len(named) > 10
    assert named <= set(metadata(ROOT).core.optional_dependencies)
    # A folder that is installed without --editable replaces an editable install by a copy.
    copies = r"install[^`#\n]*?(?<!-e)(?<!editable) ['\"]?\.(?:[/\[\s]|$)"
    assert not re.findall(copies, texts)
