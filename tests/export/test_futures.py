"""The network that predicts the others is added to a bundle, whose other answers stay the same."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from command_line import failure
from driven_bend import bend
from exported_bundles import PREDICTING, export_once, small_futures

from anchorflow_client.contract.batch import FUTURES
from anchorflow_client.errors import AbsentError, InvalidRequest
from anchorflow_client.sensors import KIND
from anchorflow_driving.sensors.bev import draw_bev
from anchorflow_driving.sensors.inputs import status_of
from anchorflow_driving.sensors.others import others_seen
from anchorflow_driving.window import Scenes
from anchorflow_export.futures import add_futures
from anchorflow_export.tracing import ExportError, TracedGraph
from anchorflow_models.futures import FuturesConfig, FuturesNetwork
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.local import LocalClient

BUNDLES = DEFAULT_BUNDLE.parent
OUTPUTS = ("futures", "future_probabilities")


@pytest.fixture(scope="module")
def added() -> Path:
    made = export_once(PREDICTING)
    for difference in made.differences:
        assert difference.error < 1e-5
    return made.path


def test_the_other_graphs_are_the_same_files(added: Path) -> None:
    before, after = (load_bundle(path).manifest for path in (BUNDLES / "goalflow", added))
    assert after.version == "9.0.0"
    assert after.training["futures"] == {"steps": 3}
    for role in ("encode", "modulate", "field", "score"):
        assert after.graphs[role] == before.graphs[role]
    assert {spec.name for spec in after.request.inputs} >= {"others", "route"}


def test_an_answer_has_futures_if_it_is_asked_for_them(added: Path) -> None:
    view = Scenes(bend(0))[0].view
    size = view.vehicle.size.astype(np.float32)
    inputs = {"bev": draw_bev(view), "ego_status": status_of(view), "vehicle_size": size}
    with LocalClient.of(added, threads=1) as client:
        told = {**inputs, "others": others_seen(view)}
        answer = client.plan(inputs=told, num_samples=8, seed=0, outputs=OUTPUTS)
        alone = client.plan(inputs=inputs, num_samples=8, seed=0, outputs=OUTPUTS)
        plain = client.plan(inputs=inputs, num_samples=8, seed=0)
        unknown = told["others"].copy()
        unknown[0, -1, KIND] = 4
        with pytest.raises(InvalidRequest, match="kinds 0, 1, 2 or 3") as refused:
            client.plan(inputs={**told, "others": unknown}, seed=0, outputs=OUTPUTS)
    assert refused.value.field == "inputs.others"
    assert answer.futures.shape == (48, 6, 8, 3)
    np.testing.assert_allclose(answer.future_probabilities.sum(-1), [1.0] + [0.0] * 47, atol=1e-6)
    with torch.no_grad():
        batched = (torch.from_numpy(told[name])[None] for name in ("others", "bev", "ego_status"))
        wanted = small_futures().eval().futures(*batched)["futures"][0]
    np.testing.assert_allclose(answer.futures, wanted, atol=1e-4)
    assert not alone.futures.any()
    with pytest.raises(AbsentError, match="futures: goalflow gives none"):
        _ = plain.futures
    assert alone.trajectories.tobytes() == plain.trajectories.tobytes()
    kept = (answer.trajectories == plain.trajectories).all((1, 2))
    assert kept.sum() >= 6  # of 8: a quarter may be careful drives
    assert alone.scores.tobytes() == plain.scores.tobytes()
    assert (answer.scores <= plain.scores).all()


def test_futures_may_be_added_again(
    added: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    again, first = shutil.copytree(added, tmp_path / "again"), load_bundle(added).manifest
    entry, graph = first.graphs[FUTURES], onnx.load(added / "futures.onnx")
    traced = TracedGraph(graph, entry.inputs, entry.outputs)  # a trace takes seconds
    monkeypatch.setattr("anchorflow_export.futures.trace", lambda *_, **__: traced)
    add_futures(small_futures(), again, training={"steps": 4})
    second = load_bundle(again).manifest
    assert second == first.model_copy(
        update={"training": {**first.training, "futures": {"steps": 4}}}
    )


def test_a_command_refuses_what_the_bundle_has_already(added: Path) -> None:
    words = ("export", BUNDLES.parents[2] / "checkpoints" / "futures.pt", "--out", added)
    assert "like: expected none, as" in failure(*words, "--like", BUNDLES / "goalflow")
    assert "name: expected none, as" in failure(*words, "--name", "other")


def test_a_bundle_with_other_inputs_or_times_is_refused(tmp_path: Path) -> None:
    wote = tmp_path / "wote"
    shutil.copytree(BUNDLES / "wote", wote)
    with pytest.raises(ExportError, match="bev: expected an input"):
        add_futures(small_futures(), wote, training={})
    goalflow = tmp_path / "goalflow"
    shutil.copytree(BUNDLES / "goalflow", goalflow)
    with pytest.raises(ExportError, match="time: expected"):
        add_futures(FuturesNetwork(FuturesConfig(num_steps=6)), goalflow, training={})
    before, after = (load_bundle(path).manifest for path in (BUNDLES / "goalflow", goalflow))
    assert after == before
