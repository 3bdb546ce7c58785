"""Bundles loaded, swapped and unloaded; what is broken leaves the old one serving."""

from __future__ import annotations

import gc
import hashlib
import weakref
from collections.abc import Callable
from pathlib import Path

import onnx
import pytest
from served import opened
from written_graphs import set_in_manifest

from anchorflow_client.errors import UnknownModel
from anchorflow_service.planning import EngineRegistry
from anchorflow_service.repository import BundleFolders, LoadError, ModelState, Repository

Write = Callable[..., Path]


@pytest.fixture
def folder(tmp_path: Path, write_bundle: Write) -> Path:
    """Return the version of the served model."""
    return write_bundle(tmp_path / "repository" / "tiny")


@pytest.fixture
def engines(folder: Path) -> EngineRegistry:
    return EngineRegistry({"tiny": opened(folder)}, default="tiny")


@pytest.fixture
def repository(engines: EngineRegistry, folder: Path) -> Repository:
    return Repository(engines, BundleFolders(repository=folder.parent), opened)


def states(repository: Repository) -> dict[tuple[str, str], tuple[str, str]]:
    return {(each.name, each.version): (each.state, each.reason) for each in repository.index()}


def test_a_bundle_that_was_written_anew_is_taken(
    repository: Repository, engines: EngineRegistry, folder: Path, write_bundle: Write
) -> None:
    before = engines.choose("tiny")
    write_bundle(folder, version="2.0")

    card = repository.load("tiny")

    assert card.version == "2.0"
    assert engines.choose("tiny").card == engines.choose(None).card == card
    assert before.card.version == "1.2.3"  # who has it keeps it
    assert repository.index() == [ModelState("tiny", "2.0", "READY", "")]


def test_a_newer_version_whose_manifest_is_broken_is_refused_and_the_old_one_goes_on(
    repository: Repository, engines: EngineRegistry, folder: Path, write_bundle: Write
) -> None:
    for version in ("2.0", "3.0"):
        write_bundle(folder.parent / "many" / version, name="many", version=version)
    (folder.parent / "many" / "3.0" / "manifest.json").write_text("{")

    for version in (None, "3.0"):
        with pytest.raises(LoadError, match=r"^manifest\.json: Invalid JSON"):
            repository.load("many", version)
    assert repository.load("many", "2.0").version == "2.0"
    with pytest.raises(LoadError):
        repository.load("many")

    assert engines.choose("many").card.version == "2.0"
    assert {name for name, _ in states(repository)} == {"tiny", "many"}
    state, reason = states(repository)["many", "3.0"]
    assert state == "UNAVAILABLE"
    assert reason.startswith("manifest.json: Invalid JSON")


def test_another_model_beside_it(
    repository: Repository, engines: EngineRegistry, folder: Path, write_bundle: Write
) -> None:
    write_bundle(folder.parent / "more", name="other")
    assert states(repository)["other", "1.2.3"] == ("UNAVAILABLE", "not loaded")

    repository.load("other")

    assert [card.name for card in engines.cards()] == ["tiny", "other"]
    assert states(repository)["other", "1.2.3"] == ("READY", "")


def test_an_older_version_can_be_taken_back(
    repository: Repository, folder: Path, write_bundle: Write
) -> None:
    write_bundle(folder.parent / "tiny-2", version="2.0")
    assert repository.load("tiny").version == "2.0"
    assert repository.load("tiny", "1.2.3").version == "1.2.3"
    assert states(repository) == {
        ("tiny", "2.0"): ("UNAVAILABLE", "not loaded"),
        ("tiny", "1.2.3"): ("READY", ""),
    }


def test_what_is_unloaded_is_not_served_and_can_come_back(
    repository: Repository, engines: EngineRegistry
) -> None:
    repository.unload("tiny")
    with pytest.raises(UnknownModel, match=r"\(none at present\), got 'tiny'"):
        engines.choose("tiny")
    with pytest.raises(UnknownModel, match="got the default, 'tiny'"):
        engines.choose(None)
    with pytest.raises(UnknownModel):
        repository.unload("tiny")
    repository.load("tiny")
    assert engines.choose(None).card.version == "1.2.3"


def wrong_hash(folder: Path) -> None:
    set_in_manifest(folder, "graphs.field.sha256", to="0" * 64)


def missing_graph(folder: Path) -> None:
    (folder / "encode.onnx").unlink()


def no_graph_at_all(folder: Path) -> None:
    write_graph(folder, "field", b"not a graph")


def no_manifest_at_all(folder: Path) -> None:
    (folder / "manifest.json").write_text("{")


def numbers_that_are_not_finite(folder: Path) -> None:
    """A field of x / 0."""
    model = onnx.parser.parse_model("""
        <ir_version: 10, opset_import: ["": 20]>
        field (float[B,N,8,7] x_t, float[B,N,8,7] prior_mean, float[B,3] modulation)
            => (float[B,N,8,7] dx_t)
        { zero = Constant <value_float = 0.0> ()
          dx_t = Div (x_t, zero) }
    """)
    write_graph(folder, "field", model.SerializeToString())


def fails_when_it_runs(folder: Path) -> None:
    """A graph that opens, and looks for the anchor 999."""
    model = onnx.parser.parse_model("""
        <ir_version: 10, opset_import: ["": 20]>
        field (float[B,N,8,7] x_t, float[B,N,8,7] prior_mean, float[B,3] modulation)
            => (float[B,N,8,7] dx_t)
        { far = Constant <value_ints = [999]> ()
          row = Gather <axis = 1> (x_t, far)
          dx_t = Add (x_t, row) }
    """)
    write_graph(folder, "field", model.SerializeToString())


def write_graph(folder: Path, role: str, data: bytes) -> None:
    (folder / f"{role}.onnx").write_bytes(data)
    set_in_manifest(folder, f"graphs.{role}.sha256", to=hashlib.sha256(data).hexdigest())


BREAKS: dict[str, tuple[Callable[[Path], None], str]] = {
    "wrong hash": (wrong_hash, "field.onnx: its sha256 is"),
    "missing graph": (missing_graph, "encode.onnx: cannot be read: No such file"),
    "no graph at all": (no_graph_at_all, "field.onnx: onnxruntime cannot open it"),
    "no manifest at all": (no_manifest_at_all, "manifest.json: Invalid JSON"),
    "not finite": (numbers_that_are_not_finite, "tiny: the warm-up "),
    "does not run": (fails_when_it_runs, "tiny: the warm-up failed"),
}


@pytest.mark.parametrize("case", BREAKS)
def test_what_is_broken_leaves_the_old_one_serving_and_says_why(
    repository: Repository, engines: EngineRegistry, folder: Path, write_bundle: Write, case: str
) -> None:
    break_it, reason = BREAKS[case]
    serving = engines.choose("tiny")
    write_bundle(folder, version="2.0")
    break_it(folder)

    with pytest.raises(LoadError) as caught:
        repository.load("tiny")

    assert engines.choose("tiny") is serving
    assert str(caught.value).startswith(reason)
    assert str(folder) not in str(caught.value)
    known = states(repository)
    assert known["tiny", "1.2.3"] == ("READY", "")
    version = "" if case == "no manifest at all" else "2.0"
    assert known["tiny", version] == ("UNAVAILABLE", str(caught.value))

    write_bundle(folder, version="2.0")
    assert repository.load("tiny").version == "2.0"
    assert states(repository) == {("tiny", "2.0"): ("READY", "")}


def test_a_bundle_of_the_same_version_that_was_not_taken_is_told_too(
    repository: Repository, folder: Path
) -> None:
    wrong_hash(folder)
    with pytest.raises(LoadError) as caught:
        repository.load("tiny")

    assert repository.index() == [ModelState("tiny", "1.2.3", "READY", str(caught.value))]


def test_an_engine_that_nobody_has_any_more_is_gone(
    repository: Repository, engines: EngineRegistry
) -> None:
    old = weakref.ref(engines.choose("tiny"))
    repository.load("tiny")
    gc.collect()
    assert old() is None
