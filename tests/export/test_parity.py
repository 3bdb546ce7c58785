"""Every planner's bundle computes what its network computes: graph by graph, and whole samples."""

from __future__ import annotations

import json
from collections import Counter
from typing import Any

import pytest
from exported_bundles import NETWORKS, export_once

from anchorflow_client.contract import ModelCard
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.planners import ADAPTERS, adapter_of
from anchorflow_service.bundle import load_bundle
from anchorflow_service.local import LocalClient


@pytest.mark.parametrize("network", NETWORKS)
def test_every_graph_and_whole_samples_are_torchs(network: str) -> None:
    made = export_once(network)
    bundle = load_bundle(made.path)
    compared = Counter(difference.what.split()[0] for difference in made.differences)
    assert {*compared} == {*bundle.manifest.graphs, "sample"}
    assert min(compared.values()) > 1  # graphs at several sizes
    assert max(difference.error for difference in made.differences) <= 1e-4
    card = bundle.card
    assert ModelCard.from_dict(json.loads(json.dumps(card.to_dict()))) == card


@pytest.mark.parametrize("planner", [name for name in ADAPTERS if name != "flowmp"])
def test_a_batch_has_the_bytes_of_its_scenes(planner: str) -> None:
    """For maps, tests/service/engine shows the same."""
    made = export_once(planner)
    client = LocalClient.of(made.path, threads=2)
    adapter = adapter_of(planner, made.network, ExportChoices())
    card = client.engine.card
    inputs: Any = adapter.request(card, {"B": 2}, 3).inputs
    asked: Any = {"seed": 1, "outputs": [spec.name for spec in card.answer.extras]}
    both = client.plan(inputs=inputs, **asked)
    for b in range(2):
        alone = client.plan(inputs={name: array[b] for name, array in inputs.items()}, **asked)
        for name, array in alone.arrays.items():
            assert both.arrays[name][b].tobytes() == array.tobytes(), name
