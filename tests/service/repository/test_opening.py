"""The models at the start of a service, and errors that prevent it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import pytest
from served import opened

from anchorflow_service.bundle import BundleError
from anchorflow_service.repository import BundleFolders, open_all
from anchorflow_service.repository.folders import RepositoryError

Write = Callable[..., Path]


def versions(folders: BundleFolders) -> list[tuple[str, str]]:
    engines = open_all(folders, opened)
    assert all(name == engine.card.name for name, engine in engines.items())
    return [(name, engine.card.version) for name, engine in engines.items()]


def test_single_folders_come_first_and_in_their_order(tmp_path: Path, write_bundle: Write) -> None:
    b, a = (write_bundle(tmp_path / name, name=name) for name in "ba")
    write_bundle(tmp_path / "repository" / "c", name="c")

    folders = BundleFolders([b, a], repository=tmp_path / "repository")
    assert versions(folders) == [("b", "1.2.3"), ("a", "1.2.3"), ("c", "1.2.3")]


def test_a_single_folder_stands_above_a_newer_version_in_the_repository(
    tmp_path: Path, write_bundle: Write
) -> None:
    mine = write_bundle(tmp_path / "mine", version="1.0")
    write_bundle(tmp_path / "repository" / "newer", version="2.0")

    folders = BundleFolders([mine], repository=tmp_path / "repository")
    assert versions(folders) == [("tiny", "1.0")]


def test_the_newest_version_that_is_whole_is_opened(
    tmp_path: Path, write_bundle: Write, caplog: pytest.LogCaptureFixture
) -> None:
    for version in ("1.0", "2.0", "3.0"):
        write_bundle(tmp_path / "repository" / "tiny" / version, version=version)
    (tmp_path / "repository" / "tiny" / "3.0" / "field.onnx").unlink()
    (tmp_path / "repository" / "odd").mkdir()
    (tmp_path / "repository" / "odd" / "manifest.json").write_text("{")

    with caplog.at_level(logging.WARNING):
        assert versions(BundleFolders(repository=tmp_path / "repository")) == [("tiny", "2.0")]
    passed_over = [record.getMessage() for record in caplog.records]
    assert any("field.onnx: cannot be read" in line for line in passed_over)
    assert any("odd/manifest.json: Invalid JSON" in line for line in passed_over)


def test_a_single_folder_that_is_broken_is_an_error(tmp_path: Path, write_bundle: Write) -> None:
    whole, broken = (write_bundle(tmp_path / name, name=name) for name in ("whole", "broken"))
    (broken / "encode.onnx").unlink()

    with pytest.raises(BundleError, match=r"broken/encode\.onnx: cannot be read"):
        open_all(BundleFolders([whole, broken]), opened)


def test_two_single_folders_of_one_model_are_an_error(tmp_path: Path, write_bundle: Write) -> None:
    folders = [write_bundle(tmp_path / version, version=version) for version in ("1", "2")]

    with pytest.raises(RepositoryError, match="expected one bundle of tiny, got two"):
        open_all(BundleFolders(folders), opened)


def test_a_repository_of_nothing_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RepositoryError, match="holds no bundle that can be served"):
        open_all(BundleFolders(repository=tmp_path), opened)
