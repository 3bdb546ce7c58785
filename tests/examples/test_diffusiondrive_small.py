"""The configuration file of a small DiffusionDriveV2 says what its preset says."""

from __future__ import annotations

from pathlib import Path

from anchorflow_models.diffusiondrive import small_diffusiondrive
from anchorflow_training.config_file import layers, planner_in
from anchorflow_training.driving.diffusiondrive_run import DiffusionDriveRunConfig

FILE = Path(__file__).parents[2] / "examples" / "diffusiondrive-small.yaml"


def test_the_file_is_the_small_preset() -> None:
    assert planner_in(FILE) == "diffusiondrive"
    assert layers(DiffusionDriveRunConfig, {}, FILE).model == small_diffusiondrive()
