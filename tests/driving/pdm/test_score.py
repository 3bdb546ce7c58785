"""The PDM score of plans with a known score."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from anchorflow_driving.drivers import DENSE_TIMES, DRIVERS, PLAN_TIMES, constant_velocity, stop
from anchorflow_driving.log import PEDESTRIAN, STATIC, read_logs
from anchorflow_driving.pdm import PdmScorer, direction_compliance
from anchorflow_driving.window import Scenes, Window

OnStreet = Callable[..., Window]
SUB_SCORES = ("nc", "dac", "ep", "ttc", "c", "pdms")


def score(window: Window, plan: np.ndarray) -> dict[str, float]:
    scores = PdmScorer(window).score(plan[None])
    return {name: float(getattr(scores, name)[0]) for name in SUB_SCORES}


def against(window: Window, plans: np.ndarray) -> np.ndarray:
    scorer = PdmScorer(window)
    return scorer.metres_against(scorer.motion(plans))


def test_a_straight_drive_at_the_limit_scores_1(on_street: OnStreet) -> None:
    window = on_street()

    found = score(window, constant_velocity(window))

    assert found == pytest.approx(dict.fromkeys(SUB_SCORES, 1.0), abs=1e-9)


def test_progress_is_measured_against_the_reference(on_street: OnStreet) -> None:
    """8 m/s of 10: 32 m, and what the vehicle still goes while it brakes."""
    window = on_street()
    slower = np.stack([8 * PLAN_TIMES, 0 * PLAN_TIMES, 0 * PLAN_TIMES], -1)

    found = score(window, slower)

    assert 32 / 40 < found["ep"] < 35 / 40
    assert found["pdms"] == pytest.approx((5 * found["ep"] + 7) / 12)


def test_stopping_goes_as_far_as_its_brakes_say(on_street: OnStreet) -> None:
    """10 m/s at 3 m/s²: 16.7 m of the reference's 40, and 0.2 s of lag at 10 m/s."""
    window = on_street()

    found = score(window, stop(window))

    assert found["ep"] == pytest.approx((100 / 6 + 0.2 * 10) / 40, abs=0.01)
    assert found["nc"] == found["dac"] == found["ttc"] == found["c"] == 1


def test_another_speed_to_begin_with_is_judged(on_street: OnStreet) -> None:
    """Stopping from 6 m/s at 3 m/s² goes 6 m and as far as the controller lags."""
    window = on_street()
    braking = np.minimum(PLAN_TIMES, 2.0)
    plan = np.stack([6 * braking - 1.5 * braking**2, 0 * braking, 0 * braking], -1)[None]

    slower = PdmScorer(window, speed=6.0)

    assert slower.motion(plan).speed[0, 0] == 6.0
    found = slower.score(plan)
    assert 6.0 < found.ep[0] * slower.progress < 9.0
    assert found.c[0] == 1.0
    assert PdmScorer(window).score(plan).c[0] == 0.0


def test_nobody_is_judged_by_progress_where_there_is_none(on_street: OnStreet, other) -> None:
    """4 m are free ahead: the reference uses some of them, which is too little to be judged by."""
    window = on_street(other(9.0, 0.0), speed=0.0)

    assert 1 < PdmScorer(window).progress < 4
    assert score(window, np.zeros((8, 3)))["ep"] == 1


@pytest.mark.parametrize(
    ("kind", "expected"),
    [(STATIC, 0.5), (PEDESTRIAN, 0.0), (0, 0.0)],
    ids=["static", "walker", "car"],
)
def test_a_plan_through_a_standing_box(
    on_street: OnStreet, other, kind: int, expected: float
) -> None:
    window = on_street(other(25.0, 0.0, kind=kind))

    found = score(window, constant_velocity(window))

    assert found["nc"] == expected
    assert found["ttc"] == 0


def test_who_is_run_into_from_behind_is_not_at_fault(on_street: OnStreet, other) -> None:
    """Nor where it changes lanes at that moment."""
    window = on_street(other(-12.0, 0.0, 14.0))
    changing = np.stack([10 * PLAN_TIMES, 1.0 * PLAN_TIMES, np.full(8, 0.1)], -1)

    for plan in (constant_velocity(window), changing):
        assert score(window, plan)["nc"] == 1


def test_who_stands_is_not_at_fault(on_street: OnStreet, other) -> None:
    window = on_street(other(12.0, 0.0, 4.0, heading=np.pi), speed=0.0)

    assert score(window, np.zeros((8, 3)))["nc"] == 1


def test_beside_another_only_who_leaves_its_lane_is_at_fault(on_street: OnStreet, other) -> None:
    """The same slow drift into a neighbour at equal speed; once it is the neighbour that drifts."""
    into = np.stack([10 * PLAN_TIMES, 0.5 * PLAN_TIMES, np.full(8, 0.05)], -1)
    inside = on_street(other(0.0, 3.0, 10.0))
    drifting = on_street(other(0.0, 2.5, 10.0, heading=-0.05))

    assert score(inside, into)["nc"] == 0
    assert score(drifting, constant_velocity(drifting))["nc"] == 1


def test_time_to_collision_looks_nine_tenths_of_a_second_ahead(on_street: OnStreet, other) -> None:
    """The box's front ends 45 m away less the rear axle's part; the other's tail is beyond it."""
    front = 10 * 4.0 + 2.5
    near, far = (on_street(other(front + gap + 2.5, 0.0)) for gap in (8.9, 9.1))

    assert score(near, constant_velocity(near))["ttc"] == 0
    assert score(far, constant_velocity(far))["ttc"] == 1
    assert score(near, constant_velocity(near))["nc"] == 1


def test_leaving_the_road(on_street: OnStreet) -> None:
    window = on_street()
    out = np.stack([10 * PLAN_TIMES, -0.5 * PLAN_TIMES, np.full(8, -0.05)], -1)

    found = score(window, out)

    assert found["dac"] == found["pdms"] == found["ep"] == 0
    assert found["nc"] == 1


def test_metres_against_the_lanes(on_street: OnStreet) -> None:
    """The left lane, from y = 2 m on, leads the other way; the vehicle is in it after 2 s."""
    there, back = (np.array([[x, y], [-x, y]]) for x, y in ((-100.0, 0.0), (200.0, 4.0)))
    two_way = on_street(centre_points=np.concatenate([there, back]).astype(np.float32))
    side = np.array([1.5, 3.5, *[4.0] * 6])
    across = np.stack([10 * PLAN_TIMES, side, 0 * PLAN_TIMES], -1)
    plans = np.stack([constant_velocity(two_way), across])

    kept, crossed = against(two_way, plans)

    assert kept == 0
    assert 18 < crossed < 22
    np.testing.assert_array_equal(against(on_street(), plans), 0)
    compliance = direction_compliance(np.array([0.0, 2.0, 12.0]))
    np.testing.assert_allclose(compliance, [1, 1, np.exp(-1)])


def test_a_lane_that_is_shared_leads_both_ways(on_street: OnStreet) -> None:
    """In a junction, a motion along one lane is not against another."""
    lanes = np.array([[-100, -2], [200, -2], [200, 2], [-100, 2]] * 2, np.float32)
    centres = np.array([[-100, 0], [200, 0], [200, 0], [-100, 0]], np.float32)
    window = on_street(lane_points=lanes, centre_points=centres)

    assert against(window, constant_velocity(window)[None]) == 0


def test_a_plan_gets_among_256_what_it_gets_alone(on_street: OnStreet, other) -> None:
    window = on_street(other(30.0, 0.0, 3.0), other(10.0, 4.0, 9.0), other(40.0, -1.5, kind=STATIC))
    rng = np.random.default_rng(3)
    speed, drift = rng.uniform(0, 14, 256)[:, None], rng.normal(0, 0.5, 256)[:, None]
    turn = np.arctan2(drift, np.maximum(speed, 1.0)) * np.ones(8)
    plans = np.stack([speed * PLAN_TIMES, drift * PLAN_TIMES, turn], -1)
    scorer = PdmScorer(window)

    together = scorer.score(plans)

    for name in SUB_SCORES:
        assert len(set(getattr(together, name))) > 1 or name == "c"
    table = [together.nc, together.dac, together.ep, together.ttc, together.c]
    np.testing.assert_array_equal(together.sub_scores, np.transpose(table))
    for index in range(0, 256, 11):
        alone = scorer.score(plans[index : index + 1])
        for name in ("nc", "dac", "ttc", "c"):
            assert getattr(alone, name)[0] == getattr(together, name)[index]
        # Matrix products of one row and of many may round differently.
        assert alone.ep[0] == pytest.approx(together.ep[index], rel=1e-12)


def test_8_poses_and_their_40_score_alike(on_street: OnStreet) -> None:
    window, scorer = on_street(), PdmScorer(on_street())
    both = [
        scorer.score(constant_velocity(window, times)[None]).pdms
        for times in (PLAN_TIMES, DENSE_TIMES)
    ]

    np.testing.assert_allclose(both[0], both[1])


@pytest.mark.parametrize(
    ("plans", "message"),
    [
        (np.zeros((8, 3)), r"expected \[P, 8, 3\] or \[P, 40, 3\], got \[8, 3\]"),
        (np.zeros((1, 9, 3)), r"got \[1, 9, 3\]"),
        (np.full((1, 8, 3), np.nan), "expected finite numbers"),
    ],
)
def test_what_is_no_plan_is_refused(on_street: OnStreet, plans: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PdmScorer(on_street()).score(plans)


def test_the_shared_judge_agrees(shared_data: Callable[[str], Path]) -> None:
    """Every 40th public window; `anchorflow bench drive` and the judge do all of them."""
    judge, logs = load_judge(shared_data("../tools/score_driving.py")), shared_data("driving")
    for log, theirs in zip(read_logs(logs), judge.load(logs), strict=True):
        scenes = Scenes(log)
        for index in range(0, len(scenes), 40):
            window = scenes[index]
            plans = np.stack([driver(window) for driver in DRIVERS.values()])
            ours, expected = (
                PdmScorer(window).score(plans),
                judge.score_poses(judge.Window(theirs, index), plans),
            )
            for name in SUB_SCORES:
                np.testing.assert_allclose(
                    getattr(ours, name), expected[name.upper()], atol=1e-6, err_msg=name
                )


def load_judge(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("shared_driving_judge", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
