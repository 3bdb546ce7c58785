"""Bundles in folders."""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from pathlib import Path

import pytest

from anchorflow_service.bundle import BundleError
from anchorflow_service.repository import BundleFolders
from anchorflow_service.repository.folders import RepositoryError, _version_order

Write = Callable[..., Path]
LayOut = Callable[..., BundleFolders]


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    (tmp_path / "repository").mkdir()
    return tmp_path / "repository"


@pytest.fixture
def lay_out(repository: Path, write_bundle: Write) -> LayOut:
    """Writes bundles, a name and a version by folder, some with a broken manifest; opens all."""

    def write(bundles: dict[str, tuple[str, str]], *broken: str) -> BundleFolders:
        for folder, (name, version) in bundles.items():
            write_bundle(repository / folder, name=name, version=version)
        for folder in broken:
            (repository / folder / "manifest.json").write_text("{")
        return BundleFolders(repository=repository)

    return write


def test_a_model_is_found_by_its_manifest_and_its_newest_version_is_taken(
    repository: Path, lay_out: LayOut
) -> None:
    """What is being exported, in a folder with a dot, is not there yet."""
    versions = ("0.9.1", "0.10.0", "0.10.0-rc1", ".0.11.0")
    folders = lay_out(
        {f"some/{each}": ("flow", each) for each in versions} | {".scratch/new": ("new", "1")}
    )

    for version, folder in ((None, "0.10.0"), ("0.9.1", "0.9.1")):
        found = folders.find("flow", version)
        assert found is not None
        assert (found.name, found.version) == ("flow", folder)
        assert found.path == repository / "some" / folder
    assert folders.find("flow", "7") is folders.find("some") is folders.find("new") is None


def test_versions_sort_as_people_read_them() -> None:
    versions = ["0.1", "0.1.0", "0.9.1", "0.10.0-a2", "0.10.0-rc1", "0.10.0", "0.10.0.1", "1" * 999]
    mixed = random.Random(0).sample(versions, len(versions))

    assert sorted(mixed, key=_version_order) == versions


def test_single_folders_and_a_repository_go_together(tmp_path: Path, write_bundle: Write) -> None:
    alone = write_bundle(tmp_path / "alone", name="alone")
    inside = write_bundle(tmp_path / "repository" / "inside", name="inside")
    folders = BundleFolders([alone, inside], repository=tmp_path / "repository")

    assert [(each.name, each.path) for each in folders.found()] == [
        ("alone", alone),
        ("inside", inside),  # once, although it is named twice
    ]


def test_two_folders_of_one_version_cannot_be_told_apart(lay_out: LayOut) -> None:
    with pytest.raises(RepositoryError, match=r"one bundle of flow 1\.2\.3, found it in two"):
        lay_out(dict.fromkeys("ab", ("flow", "1.2.3"))).find("flow")


@pytest.mark.parametrize(
    ("place", "version", "other"), [("flow", "", "tiny"), ("flow/1.0", "1.0", "1.0")]
)
def test_a_broken_manifest_is_known_by_its_folder_or_that_of_versions(
    lay_out: LayOut, place: str, version: str, other: str
) -> None:
    folders = lay_out({place: ("tiny", "1.2.3")}, place)

    assert [(each.name, each.version) for each in folders.found()] == [("flow", version)]
    with pytest.raises(BundleError, match=r"manifest\.json: Invalid JSON"):
        folders.find("flow")
    assert folders.find(other) is None


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
@pytest.mark.timeout(60)
def test_a_manifest_that_is_no_file_is_known_by_its_folder(
    repository: Path, lay_out: LayOut, make: Callable[[Path], None]
) -> None:
    """Reading a pipe would block until a write."""
    (repository / "flow").mkdir()
    make(repository / "flow" / "manifest.json")

    broken, whole = lay_out({"whole": ("whole", "1")}).found()
    assert (broken.name, whole.name, whole.fault) == ("flow", "whole", None)
    assert broken.fault is not None
    assert broken.fault.reason == "manifest.json: cannot be read: not a regular file"


def test_a_broken_manifest_among_versions_is_one_of_them(repository: Path, lay_out: LayOut) -> None:
    """A broken newest one is an error; an older one keeps none back."""
    name, *versions = "flow-small", "0.9.1", "0.10.0", "0.11.0"
    folders = lay_out({f"flow/{each}": (name, each) for each in versions}, "flow/0.9.1")
    newest = folders.find(name)
    assert newest is not None
    assert newest.version == "0.11.0"
    (repository / "flow" / "0.11.0" / "manifest.json").write_text("{")

    found = [(each.name, each.version, each.fault is None) for each in folders.found()]
    assert found == [(name, "0.11.0", False), (name, "0.10.0", True), (name, "0.9.1", False)]
    for version, folder in ((None, "0.11.0"), ("0.11.0", "0.11.0"), ("0.9.1", "0.9.1")):
        with pytest.raises(BundleError, match=rf"flow/{folder}/manifest\.json: Invalid JSON"):
            folders.find(name, version)
    whole = folders.find(name, "0.10.0")
    assert whole is not None
    assert whole.path == repository / "flow" / "0.10.0"
    assert folders.find(name, "0.12.0") is None


def test_a_folder_without_a_manifest_and_a_repository_that_is_none_are_told(tmp_path: Path) -> None:
    with pytest.raises(BundleError, match=r"manifest\.json: cannot be read"):
        BundleFolders([tmp_path / "nothing"]).find("nothing")
    with pytest.raises(RepositoryError, match="expected a folder of bundles, found none"):
        BundleFolders(repository=tmp_path / "nowhere")
