"""What rules predict of others who turn, and how predictions are judged."""

from __future__ import annotations

import numpy as np
import pytest
from driven_bend import bend

from anchorflow_client.errors import InvalidRequest
from anchorflow_client.sensors import KIND, others_before
from anchorflow_driving.futures import (
    RULES,
    Futures,
    judge_futures,
    recorded_futures,
)
from anchorflow_driving.lane_paths import LanePaths
from anchorflow_driving.sensors.others import others_seen
from anchorflow_driving.window import Scenes, Window


@pytest.fixture
def window() -> Window:
    """The last but one: an ego and a leader 20 m ahead, on an arc, at 8 m/s."""
    return Scenes(bend(0))[1]


def test_who_is_told_of_is_there_with_its_past(window: Window) -> None:
    others = others_seen(window.view)
    assert others.shape == (48, 5, 8)
    assert (others[1:] == 0).all()
    now, before = others[0, -1], others[0, 0]
    np.testing.assert_allclose(now[:3], window.view.tracks[1, -1, :3], rtol=1e-6)
    assert now[5:].tolist() == pytest.approx([4.6, 1.9, 1.0])
    assert np.hypot(*(now[:2] - before[:2])) == pytest.approx(16.0, rel=0.02)  # 2 s at 8 m/s


def test_a_turn_rate_and_a_lane_lead_where_it_drove(window: Window) -> None:
    others, recorded = others_seen(window.view), recorded_futures(window)
    away = {}
    for name, rule in RULES.items():
        figures = judge_futures(rule(window.view, others), recorded, others)
        assert len(figures["minADE"]) == 1
        away[name] = float(figures["minADE"][0])
    assert away["constant_velocity"] > 3.0
    assert away["constant_turn"] < 0.05
    assert away["along_lanes"] < 0.05


def test_modes_are_judged_by_the_nearest_and_by_the_likeliest() -> None:
    recorded = np.zeros((2, 8, 3))
    recorded[0, :, 0] = np.arange(1, 9)
    recorded[1, -1] = np.nan  # not recorded to the end
    others = np.zeros((2, 5, 8), np.float32)
    others[:, :, KIND] = 1
    poses = np.repeat(recorded[:, None], 3, 1)
    poses[0, 0, :, 1] = 3.0
    poses[0, 1, :, 1] = 1.0
    poses[0, 2, -1, 1] = 5.0
    probabilities = np.tile([0.5, 0.3, 0.2], (2, 1))
    figures = judge_futures(Futures(poses, probabilities), recorded, others)
    assert figures["minADE"].tolist() == pytest.approx([5 / 8])
    assert figures["minFDE"].tolist() == pytest.approx([1.0])
    assert figures["ADE"].tolist() == pytest.approx([3.0])
    assert figures["miss"].tolist() == [0.0]
    assert figures["moves"].tolist() == [True]


def test_ways_fork_where_lanes_do_and_the_straight_one_comes_first() -> None:
    trunk = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]])
    left = np.array([[20.0, 0.0], [30.0, 4.0], [30.0, 40.0]])
    on = np.array([[20.0, 0.0], [90.0, 0.0]])
    against = np.array([[90.0, 3.0], [0.0, 3.0]])
    lanes = LanePaths([left, against, trunk, on])
    straight, turning = lanes.ahead(np.array([5.0, 0.5, 0.1]), most=3)
    poses = straight.poses(np.array([0.0, 35.0, 200.0]))
    np.testing.assert_allclose(poses, [[5, 0.5, 0], [40, 0, 0], [205, 0, 0]], atol=1e-9)
    assert turning.poses(np.array([40.0]))[0, 2] == pytest.approx(np.pi / 2)
    assert len(lanes.ahead(np.array([5.0, 3.2, np.pi]), most=3)) == 1
    assert not lanes.ahead(np.array([5.0, -3.0, 0.0]), most=3)
    assert not LanePaths([]).ahead(np.zeros(3), most=3)
    short = [np.array([[0.1 * k, 0.0], [0.1 * k + 0.1, 0.0]]) for k in range(3)]
    assert LanePaths(short).ahead(np.zeros(3), most=3)  # each begins near the end of each


def test_who_brakes_stands_and_does_not_reverse(window: Window) -> None:
    others = others_seen(window.view)
    others[..., 3:5] *= 0.1
    modes = RULES["along_lanes"](window.view, others).poses[0]
    assert modes.shape == (6, 8, 3)
    # From 0.8 m/s at 1.5 m/s²: v² / 2a.
    gone = np.linalg.norm(modes[1, :, :2] - others[0, -1, :2], axis=-1)
    np.testing.assert_allclose(gone[1:], 0.8**2 / 3.0, rtol=1e-3)


@pytest.mark.parametrize(
    ("field", "states", "size", "kind"),
    [
        ("states", np.zeros((2, 4, 5)), np.ones((2, 2)), [1, 1]),
        ("size", np.zeros((2, 5, 5)), np.ones((3, 2)), [1, 1]),
        ("size", np.zeros((2, 5, 5)), np.array([[1, 1], [1, np.nan]]), [1, 1]),
        ("kind", np.zeros((2, 5, 5)), np.ones((2, 2)), [1, 4]),
    ],
)
def test_wrong_others_are_refused_by_name(
    field: str, states: np.ndarray, size: np.ndarray, kind: list[int]
) -> None:
    with pytest.raises(InvalidRequest) as caught:
        others_before(states, size, kind)
    assert caught.value.field == field


def test_the_nearest_are_told_first_and_who_is_gone_not_at_all() -> None:
    states = np.zeros((60, 5, 5))
    states[:, :, 0] = 100.0 - np.arange(60)[:, None]
    states[59, -1] = np.nan
    states[58, :2] = np.nan
    states[55, -1, 3] = np.nan  # a place without a velocity: not told
    others = others_before(states, np.ones((60, 2)), np.full(60, 2))
    assert others[:4, -1, 0].tolist() == [42.0, 43.0, 44.0, 46.0]
    assert others[0, :, KIND].tolist() == [0, 0, 2, 2, 2]
    assert len(others) == 48
