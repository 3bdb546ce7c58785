"""The examples to imitate in a window."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from driven_bend import bend

from anchorflow_driving.drivers import PLAN_TIMES, idm
from anchorflow_driving.log import DRIVEN
from anchorflow_driving.window import Scenes
from anchorflow_training.driving.diffusiondrive_objective import examples
from anchorflow_training.driving.labels import example
from anchorflow_training.driving.losses import shares


def test_what_was_recorded_is_an_example() -> None:
    window = Scenes(bend(0))[0]
    np.testing.assert_array_equal(example(window), window.recorded(PLAN_TIMES))


def test_where_a_planner_drove_pdm_closed_is() -> None:
    window = Scenes(replace(bend(0), source=DRIVEN))[0]
    shown = example(window)
    assert shown is not None
    np.testing.assert_array_equal(shown, idm(window))
    assert not np.allclose(shown, window.recorded(PLAN_TIMES))


def test_whoever_has_left_the_route_shows_nothing() -> None:
    log = bend(0)
    aside = replace(
        log, source=DRIVEN, route_points=log.route_points + np.array([0.0, 9.0], np.float32)
    )
    assert example(Scenes(aside)[0]) is None
    recorded = replace(aside, source=log.source)
    assert example(Scenes(recorded)[0]) is not None


def test_windows_without_an_example_have_no_share() -> None:
    assert shares(torch.tensor([1.0, 0.0, 1.0])).tolist() == [0.5, 0.0, 0.5]
    assert shares(torch.zeros(3)).tolist() == [0.0, 0.0, 0.0]
    batch = {"is_example": torch.tensor([1.0, 0.0, 1.0])}
    at_another_speed = torch.tensor([torch.nan, torch.nan, 4.0])
    assert examples(batch, at_another_speed).tolist() == [1.0, 0.0, 0.0]
