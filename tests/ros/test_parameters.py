"""The node's parameters: each is checked, and named where it is wrong."""

from __future__ import annotations

from typing import Any

import pytest

from anchorflow_client import InvalidRequest
from anchorflow_ros.parameters import PARAMETERS, Settings


def test_the_defaults_are_valid() -> None:
    settings = Settings.of()

    assert settings.robot.kind == "differential"
    assert settings.tick_s == 0.05
    assert settings.options["num_samples"] == PARAMETERS["service.num_samples"][0]
    assert settings.transforms == ()
    assert settings.planner.margin_m == settings.controller.margin


def test_a_footprint_is_read_as_nav2_writes_it() -> None:
    corners = "[ [0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2] ]"

    robot = Settings.of({"robot.footprint": corners}).robot

    assert robot.radius is None
    assert robot.reach == pytest.approx(0.36, abs=0.001)


def test_options_and_model_are_fields_of_requests() -> None:
    given = {"service.options": '{"w_style": [1, 0, 0]}', "service.model": "wide"}

    options = Settings.of(given).options

    assert options == {"num_samples": 16, "w_style": [1, 0, 0], "model": "wide"}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("rate_hz", 0.0),
        ("robot.kind", "tricycle"),
        ("robot.v_max", -1.0),
        ("robot.footprint", "[[0, 1]"),
        ("robot.footprint", "[[0, 1]]"),
        ("service.options", "[1]"),
        ("service.silence_s", -0.1),
        ("map.type", "octomap"),
        ("map.unknown", "wall"),
        ("map.window_m", -1.0),
        ("goal.beyond_map", "jump"),
        ("tracks.growth", float("nan")),
    ],
)
def test_a_parameter_that_is_wrong_is_named(name: str, value: Any) -> None:
    with pytest.raises(InvalidRequest, match=name.replace(".", r"\.")):
        Settings.of({name: value})


def test_an_unknown_parameter_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="robot_radius"):
        Settings.of({"robot_radius": 0.3})


def test_a_car_requires_a_turning_radius() -> None:
    with pytest.raises(InvalidRequest, match=r"robot\.min_turning_radius"):
        Settings.of({"robot.kind": "ackermann"})
