"""The configuration files name their planner, are read as its run's, and build its network."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import pytest
import torch
from small_configs import BACKBONE, DIFFUSIONDRIVE, EXAMPLES, GOALFLOW

from anchorflow_models.registry import PLANNERS
from anchorflow_training.planners import TRAININGS
from anchorflow_training.settings import PLANNER, layers, text_in

DOCS = EXAMPLES.parent / "docs"


@pytest.mark.parametrize("planner", ["wote", "diffusiondrive"])
def test_a_configuration_file_names_its_planner(planner: str) -> None:
    assert text_in(EXAMPLES / f"{planner}-small.yaml", PLANNER) == planner


@pytest.mark.parametrize(
    ("planner", "millions"), [("goalflow", 160.9), ("wote", 65.1), ("diffusiondrive", 91.1)]
)
def test_a_published_configuration_builds_a_network_of_its_size(
    planner: str, millions: float
) -> None:
    file = EXAMPLES / f"{planner}-published.yaml"
    config = layers(TRAININGS[planner].config, {}, file)
    with torch.device("meta"):  # shapes alone
        model = PLANNERS[planner].create(config.model)
    count = sum(each.numel() for each in model.parameters())
    assert count / 1e6 == pytest.approx(millions, abs=0.05)
    assert f"{millions} million" in (DOCS / f"{planner}.md").read_text()


@pytest.mark.parametrize(("variant", "millions"), [("base", 234.2), ("large", 773.1)])
def test_the_published_training_of_v2x_vlm_is_of_florence_in_its_size(
    variant: Literal["base", "large"], millions: float
) -> None:
    """Both pictures of 768 pixels and a prompt fit into base's 1,024 positions."""
    config = layers(TRAININGS["v2x_vlm"].config, {}, EXAMPLES / "v2x-vlm-published.yaml").model
    shape = replace(config, variant=variant, vocabulary=51_289, image_size=768)
    with torch.device("meta"):
        model = PLANNERS["v2x_vlm"].create(shape)
    assert sum(each.numel() for each in model.parameters()) / 1e6 == pytest.approx(
        millions, abs=0.05
    )
    assert shape.positions == 1024
    assert f"{millions} million" in (DOCS / "v2x-vlm.md").read_text()


def test_all_that_see_do_so_alike() -> None:
    assert DIFFUSIONDRIVE.backbone == BACKBONE == GOALFLOW.transfuser
