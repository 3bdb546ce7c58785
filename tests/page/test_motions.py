"""Anchors in time, module by module: plans, warm starts, durations, braking; and named styles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from anchorflow_client.contract.fields import STYLES

pytest.importorskip("playwright.sync_api", reason="playwright is not installed")


def test_a_plan_runs_through_its_samples_and_is_smooth_between(call: Callable[..., Any]) -> None:
    t = np.arange(9) * 0.5
    cubic = np.stack([t**3 - 2 * t, 0.5 * t**2], -1)
    slope, bend = np.stack([3 * t**2 - 2, t], -1), np.stack([6 * t, np.ones(9)], -1)
    make = """(m, [p, v, a, times]) => {
        const flat = (rows) => Float32Array.from(rows.flat());
        const [positions, velocities, accelerations] = [p, v, a].map(flat);
        const motion = { positions, velocities, accelerations };
        const plan = new m.Plan({ steps: 9, dts: [0.5], safe: [true], ...motion }, 0);
        return times.map((time) => Object.values(plan.at(time)));
    }"""
    times = np.linspace(0, 4, 37)

    states = np.array(
        call("map/plan", make, [cubic.tolist(), slope.tolist(), bend.tolist(), times.tolist()])
    )

    # Cubic polynomials between the samples give a cubic motion back exactly.
    exact = [times**3 - 2 * times, times**2 / 2, 3 * times**2 - 2, times, 6 * times, times**0]
    np.testing.assert_allclose(states, np.stack(exact, -1), atol=1e-4)


@pytest.mark.parametrize(("own", "dt"), [(True, 1.5 / 8), (False, 0.25)])
def test_what_is_left_of_a_plan_is_a_warm_start_in_its_own_time(
    own: bool, dt: float, call: Callable[..., Any]
) -> None:
    make = """(m, hasOwnTime) => {
        const line = (x) => Float32Array.from({ length: 18 }, (_, k) => (k % 2 ? 0 : x(k / 2)));
        const [still, fast] = [line(() => 0), line((t) => 0.5 * t)];
        const both = (values) => Float32Array.from([...still, ...values]);
        const anchors = {
            steps: 9, hasOwnTime, dts: [1, 0.25], safe: [true, true], positions: both(fast),
            velocities: both(line(() => 2)), accelerations: both(line(() => 0)),
        };
        return new m.Plan(anchors, 1).rest(0.5);
    }"""

    warm = call("map/plan", make, own)

    # Of 2 s and 4 m, half a second and 1 m are over.
    assert warm["dt"] == pytest.approx(dt)
    trajectory = np.array(warm["trajectory"])
    way = np.minimum(1.0 + 2.0 * dt * np.arange(9), 4.0)
    np.testing.assert_allclose(trajectory[:, 0], way, atol=1e-4)
    np.testing.assert_allclose(trajectory[:, 2], 2.0, atol=1e-4)


@pytest.mark.parametrize(
    ("dt", "durations", "text", "own"),
    [
        ("0.5", [2.0, 2.0, 2.0], "2.0 s", False),
        ("0.5, first_s: 0.5", [2.5, 2.5, 2.5], "2.5 s", False),  # from now on
        (
            "{ shape: [3], values: Float64Array.of(1, 2, 3) }",
            [4.0, 8.0, 12.0],
            "4.0 to 8.0 s",
            True,
        ),
        ("[1, 2, 3]", [4.0, 8.0, 12.0], "4.0 to 8.0 s", True),
    ],
)
def test_each_anchor_lasts_as_long_as_the_answer_says(
    dt: str, durations: list[float], text: str, own: bool, call: Callable[..., Any]
) -> None:
    make = f"""(m) => {{
        const trajectories = {{ shape: [3, 5, 2], values: new Float32Array(30) }};
        const safe = {{ shape: [3], values: Uint8Array.of(1, 1, 0) }};
        const card = {{ conditioning: {{ limits: {{ v_max: 2 }} }} }};
        const anchors = new m.Anchors({{ trajectories, safe, dt: {dt}, timing: {{}} }}, card);
        const durations = [0, 1, 2].map((n) => anchors.duration(n));
        return [durations, anchors.durationsText, anchors.hasOwnTime, anchors.time(1, 4)];
    }}"""

    told = call("anchors", make, None)

    assert told == [pytest.approx(durations), text, own, pytest.approx(durations[1])]


def test_the_pages_styles_are_the_contracts(call: Callable[..., Any]) -> None:
    make = """(m, weights) => [m.STYLES, weights.map(m.styleName)]"""

    styles, names = call("map/styles", make, [[0.1, 0.8, 0.1], [0.1, 0.799, 0.101], [0.5, 0.5, 0]])

    assert styles == {name: list(weights) for name, weights in STYLES.items()}
    assert names[0] == "efficient"
    assert names[2] == "custom"


def test_a_robot_that_brakes_comes_to_rest_within_its_limit(call: Callable[..., Any]) -> None:
    make = """(m, times) => {
        const stop = new m.Stop({ x: 1, y: 2, vx: 0, vy: 2 }, { a_max: 3 });
        return times.map((time) => Object.values(stop.at(time)));
    }"""
    times = np.linspace(0, 2, 41)

    x, y, vx, vy, ax, ay = np.array(call("map/plan", make, times.tolist())).T

    np.testing.assert_allclose(x, 1)
    np.testing.assert_allclose(vx, 0)
    np.testing.assert_allclose(ax, 0)
    assert np.abs(ay).max() <= 3
    assert vy[-1] == pytest.approx(0, abs=1e-9)
    assert y[-1] == pytest.approx(2 + 2**2 / (2 * np.abs(ay).max()))
    np.testing.assert_allclose(np.gradient(y, times)[1:15], vy[1:15], atol=1e-6)
