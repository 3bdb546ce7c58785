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


def test_a_model_is_found_by_what_its_manifest_says(tmp_path: Path, write_bundle: Write) -> None:
    write_bundle(tmp_path / "repository" / "some-folder", name="flow")
    folders = BundleFolders(repository=tmp_path / "repository")

    found = folders.find("flow")
    assert found is not None
    assert (found.name, found.version) == ("flow", "1.2.3")
    assert found.path == tmp_path / "repository" / "some-folder"
    assert folders.find("some-folder") is None


def test_the_newest_version_is_taken_unless_one_is_named(
    tmp_path: Path, write_bundle: Write
) -> None:
    for version in ("0.9.1", "0.10.0", "0.10.0-rc1"):
        write_bundle(tmp_path / "flow" / version, name="flow", version=version)
    folders = BundleFolders(repository=tmp_path)

    newest, named = folders.find("flow"), folders.find("flow", "0.9.1")
    assert newest is not None
    assert newest.version == "0.10.0"
    assert named is not None
    assert named.path == tmp_path / "flow" / "0.9.1"
    assert folders.find("flow", "7") is None


def test_what_is_being_exported_is_not_there_yet(tmp_path: Path, write_bundle: Write) -> None:
    repository = tmp_path / "repository"
    write_bundle(repository / ".flow-scratch" / "new", name="flow")
    write_bundle(repository / "flow" / ".0.2.0", name="flow")
    assert BundleFolders(repository=repository).found() == []


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


def test_two_folders_of_one_version_cannot_be_told_apart(
    tmp_path: Path, write_bundle: Write
) -> None:
    for folder in ("a", "b"):
        write_bundle(tmp_path / folder, name="flow")

    with pytest.raises(RepositoryError, match=r"one bundle of flow 1\.2\.3, found it in two"):
        BundleFolders(repository=tmp_path).find("flow")


@pytest.mark.parametrize(
    ("place", "version", "other"), [("flow", "", "tiny"), ("flow/1.0", "1.0", "1.0")]
)
def test_a_broken_manifest_is_known_by_its_folder_or_that_of_versions(
    tmp_path: Path, write_bundle: Write, place: str, version: str, other: str
) -> None:
    (write_bundle(tmp_path / "repository" / place) / "manifest.json").write_text("{")
    folders = BundleFolders(repository=tmp_path / "repository")

    assert [(each.name, each.version) for each in folders.found()] == [("flow", version)]
    with pytest.raises(BundleError, match=r"manifest\.json: Invalid JSON"):
        folders.find("flow")
    assert folders.find(other) is None


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
@pytest.mark.timeout(60)
def test_a_manifest_that_is_no_file_is_known_by_its_folder(
    tmp_path: Path, write_bundle: Write, make: Callable[[Path], None]
) -> None:
    """Reading a pipe would block until a write."""
    write_bundle(tmp_path / "repository" / "whole", name="whole")
    (tmp_path / "repository" / "flow").mkdir()
    make(tmp_path / "repository" / "flow" / "manifest.json")

    broken, whole = BundleFolders(repository=tmp_path / "repository").found()
    assert (broken.name, whole.name, whole.fault) == ("flow", "whole", None)
    assert broken.fault is not None
    assert broken.fault.reason == "manifest.json: cannot be read: not a regular file"


def test_a_broken_manifest_among_versions_is_one_of_them(
    tmp_path: Path, write_bundle: Write
) -> None:
    for version in ("0.9.1", "0.10.0", "0.11.0"):
        folder = write_bundle(
            tmp_path / "repository" / "flow" / version, name="flow-small", version=version
        )
        if version != "0.10.0":
            (folder / "manifest.json").write_text("{")
    folders = BundleFolders(repository=tmp_path / "repository")

    found = [(each.name, each.version, each.fault is None) for each in folders.found()]
    assert found == [
        ("flow-small", "0.11.0", False),
        ("flow-small", "0.10.0", True),
        ("flow-small", "0.9.1", False),
    ]
    for version, folder in ((None, "0.11.0"), ("0.11.0", "0.11.0"), ("0.9.1", "0.9.1")):
        with pytest.raises(BundleError, match=rf"flow/{folder}/manifest\.json: Invalid JSON"):
            folders.find("flow-small", version)
    whole = folders.find("flow-small", "0.10.0")
    assert whole is not None
    assert whole.path == tmp_path / "repository" / "flow" / "0.10.0"
    assert folders.find("flow-small", "0.12.0") is None


def test_an_older_version_that_is_broken_keeps_no_newer_one_back(
    tmp_path: Path, write_bundle: Write
) -> None:
    for version in ("0.9.1", "0.10.0"):
        write_bundle(tmp_path / "repository" / "flow" / version, name="flow", version=version)
    (tmp_path / "repository" / "flow" / "0.9.1" / "manifest.json").write_text("{")

    found = BundleFolders(repository=tmp_path / "repository").find("flow")
    assert found is not None
    assert found.version == "0.10.0"


def test_a_single_folder_without_a_manifest_is_told(tmp_path: Path) -> None:
    with pytest.raises(BundleError, match=r"manifest\.json: cannot be read"):
        BundleFolders([tmp_path / "nothing"]).find("nothing")


def test_a_repository_must_be_there(tmp_path: Path) -> None:
    with pytest.raises(RepositoryError, match="expected a folder of bundles, found none"):
        BundleFolders(repository=tmp_path / "nowhere")
