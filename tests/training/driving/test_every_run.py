"""What holds for the run of every planner that learns from driving logs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn_bend import drawn
from driving_runs import AGENTS, RUNS
from training_runs import assert_same_weights, resumed_and_whole

from anchorflow_models.registry import planner_named
from anchorflow_training.checkpoint import load_checkpoint, restore_model
from anchorflow_training.driving import sensor_windows
from anchorflow_training.planners import TRAININGS
from anchorflow_training.settings import ConfigError


@pytest.fixture(params=RUNS)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def data(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """What is trained on, its sensors without a graphics driver."""
    planner = RUNS[name].planner
    monkeypatch.setattr(sensor_windows, "sensed", partial(drawn, agents=AGENTS.get(planner, 4)))
    return TRAININGS[planner].open_data(folder)


@pytest.fixture
def new_run(name: str, data: Any, tmp_path: Path) -> Callable[..., Any]:
    """Makes a run of changed settings in a folder of the test's own."""
    run = TRAININGS[RUNS[name].planner].run
    return lambda out="run", **changed: run(replace(RUNS[name], **changed), data, tmp_path / out)


def test_a_run_that_was_cut_goes_on_as_if_it_had_not_been_and_is_restored(
    name: str, new_run: Callable[..., Any]
) -> None:
    resumed, whole = resumed_and_whole(new_run)
    assert_same_weights(resumed.model, whole.model)
    saved = load_checkpoint(whole.checkpoint_path)
    restored = restore_model(saved)
    assert saved.planner == RUNS[name].planner
    assert type(restored) is type(planner_named(saved.planner).create(whole.config.model))
    assert_same_weights(restored, whole.averaged_model())
    row = whole.evaluations[-1]
    assert 0.0 <= row["success"] <= row.get("pdms_of_the_best", 1.0) <= 1.0
    assert row.get("best_ade_m", 0.0) < 20.0
    assert row.get("min_ade_m", 0.0) < 40.0


def test_a_batch_is_the_same_whenever_it_is_asked_for(new_run: Callable[..., Any]) -> None:
    run = new_run()
    first, again = run.batch(3), [*run.stream([2, 3])][1]
    for name, array in first.items():
        np.testing.assert_array_equal(again[name], array, err_msg=name)


def test_a_batch_of_more_windows_than_there_are_is_refused(
    name: str, new_run: Callable[..., Any]
) -> None:
    batch = replace(RUNS[name].batch, scenes=99)
    with pytest.raises(ConfigError, match=r"batch.scenes: expected at most \d+, .* got 99"):
        new_run(batch=batch)


def test_the_data_decide_the_raster_the_times_and_the_classes(name: str, data: Any) -> None:
    settings = TRAININGS[RUNS[name].planner].run.model_settings(data)
    assert settings
    for field, value in settings.items():
        told = getattr(RUNS[name].model, field)
        assert value == (vars(told) if field == "bev" else told), field
