"""The configuration files of small networks name their planner, and are read as its run's."""

from __future__ import annotations

import pytest
from small_configs import BACKBONE, DIFFUSIONDRIVE, EXAMPLES

from anchorflow_training.settings import planner_in


@pytest.mark.parametrize("planner", ["wote", "diffusiondrive"])
def test_a_configuration_file_names_its_planner(planner: str) -> None:
    assert planner_in(EXAMPLES / f"{planner}-small.yaml") == planner


def test_both_see_alike() -> None:
    assert DIFFUSIONDRIVE.backbone == BACKBONE
