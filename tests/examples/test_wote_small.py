"""The configuration file of a small WoTE says what `small_wote` says."""

from __future__ import annotations

from pathlib import Path

from anchorflow_models.wote import small_wote
from anchorflow_training.config_file import layers, planner_in
from anchorflow_training.driving.wote_run import WoteRunConfig

FILE = Path(__file__).parents[2] / "examples" / "wote-small.yaml"


def test_the_file_is_the_small_preset() -> None:
    assert planner_in(FILE) == "wote"
    assert layers(WoteRunConfig, {}, FILE).model == small_wote()
