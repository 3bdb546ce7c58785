"""The page's own arithmetic, module by module, inside the browser that runs it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

KINDS = ("forest", "rooms", "city", "maze", "empty")


@pytest.fixture(scope="module")
def call(browser: Any, served: Any) -> Iterator[Callable[..., Any]]:
    """Calls a function of JavaScript with `m`, the module of that name, and an argument."""
    context = browser.new_context()
    page = context.new_page()
    page.goto(served.url)

    def run(module: str, function: str, argument: Any = None) -> Any:
        script = f"async (argument) => ({function})(await import('/page/js/{module}.js'), argument)"
        return page.evaluate(script, argument)

    yield run
    context.close()


def sample(call: Callable[..., Any], kind: str, number: int) -> np.ndarray:
    """[96, 96] whether a cell is occupied."""
    make = "(m, [kind, number]) => m.sampleMap(kind, number).occupancy()"
    return np.array(call("map/samples", make, [kind, number]), bool)


def test_distances_are_those_of_scipy(call: Callable[..., Any]) -> None:
    rng = np.random.default_rng(0)
    occupied = rng.random((20, 31)) < 0.05
    occupied[3, 4] = True
    make = """async (m, rows) => {
        const { Grid } = await import("/page/js/map/grid.js");
        const grid = new Grid(rows.length, rows[0].length, 0.2);
        rows.forEach((row, r) => row.forEach((cell, c) => grid.set(r, c, cell ? 1 : 0)));
        return Array.from(m.distanceField(grid));
    }"""

    field = np.array(call("map/distance", make, occupied.tolist())).reshape(occupied.shape)

    between_centres = np.asarray(ndimage.distance_transform_edt(~occupied))
    np.testing.assert_allclose(field, 0.2 * np.maximum(between_centres - 0.5, 0), atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_samples_repeat_and_differ(call: Callable[..., Any], kind: str) -> None:
    one, again, another = (sample(call, kind, number) for number in (1, 1, 2))

    assert one.shape == (96, 96)
    np.testing.assert_array_equal(one, again)
    assert kind == "empty" or (one != another).any()
    assert one.mean() < 0.6


@pytest.mark.parametrize("kind", KINDS)
def test_start_and_goal_stand_clear_and_are_joined(call: Callable[..., Any], kind: str) -> None:
    place = """async (m, [kind, number]) => {
        const { placeEnds } = await import("/page/js/map/ends.js");
        const { start, goal } = placeEnds(m.sampleMap(kind, number), { radius: 0.25, reach: 8 });
        return [[start.x, start.y], [goal.x, goal.y]];
    }"""
    for number in range(4):
        occupied = sample(call, kind, number)
        clear = 0.1 * (np.asarray(ndimage.distance_transform_edt(np.pad(~occupied, 0))) - 0.5)
        if not occupied.any():
            clear = np.full(occupied.shape, np.inf)
        ends = np.array(call("map/samples", place, [kind, number]))
        (start, goal) = ((ends + 4.8) / 0.1).astype(int)[:, ::-1]
        regions = ndimage.label(clear > 0.25)[0]  # type: ignore[index]

        assert clear[tuple(start)] > 0.25
        assert clear[tuple(goal)] > 0.25
        assert regions[tuple(start)] == regions[tuple(goal)]
        assert 3.0 < np.linalg.norm(ends[1] - ends[0]) <= 8.0


def test_a_plan_runs_through_its_samples_and_is_smooth_between(call: Callable[..., Any]) -> None:
    t = np.arange(9) * 0.5
    cubic = np.stack([t**3 - 2 * t, 0.5 * t**2], -1)
    slope, bend = np.stack([3 * t**2 - 2, t], -1), np.stack([6 * t, np.ones(9)], -1)
    make = """(m, [p, v, a, times]) => {
        const flat = (rows) => Float32Array.from(rows.flat());
        const [positions, velocities, accelerations] = [p, v, a].map(flat);
        const anchors = { steps: 9, dt: 0.5, safe: [true], positions, velocities, accelerations };
        const plan = new m.Plan(anchors, 0);
        return times.map((time) => Object.values(plan.at(time)));
    }"""
    times = np.linspace(0, 4, 37)

    states = np.array(
        call("map/plan", make, [cubic.tolist(), slope.tolist(), bend.tolist(), times.tolist()])
    )

    # Cubic polynomials between the samples give a cubic motion back exactly.
    exact = [times**3 - 2 * times, times**2 / 2, 3 * times**2 - 2, times, 6 * times, times**0]
    np.testing.assert_allclose(states, np.stack(exact, -1), atol=1e-4)


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


def test_only_the_right_line_is_picked(call: Callable[..., Any]) -> None:
    make = """(m, points) => {
        const line = (y) => Array.from({ length: 5 }, (_, t) => [t, y]).flat();
        const positions = Float32Array.from([...line(0), ...line(1)]);
        const anchors = { count: 2, steps: 5, positions };
        const stage = { scale: 100, toScreen: (x, y) => [100 * x, 500 - 100 * y] };
        return points.map(([left, top]) => m.pick(stage, anchors, left, top));
    }"""

    near_second, near_first, far = call("lines", make, [[310, 405], [90, 490], [200, 450]])

    assert near_second == {"anchor": 1, "step": 3}
    assert near_first == {"anchor": 0, "step": 1}
    assert far is None


def test_curvature_is_that_of_a_circle(call: Callable[..., Any]) -> None:
    angle = np.linspace(0, 2, 16)
    ring = 2.0 * np.stack([np.cos(angle), np.sin(angle)], -1)
    along = 1.5 * np.stack([-np.sin(angle), np.cos(angle)], -1)
    inward = -(1.5**2 / 2.0) * ring / 2.0
    tensors = {
        "trajectories": ring[None],
        "velocities": along[None],
        "accelerations": inward[None],
        "scores": np.array([-1.0]),
        "clearance": np.array([0.3]),
        "safe": np.array([1]),
    }
    answer = {
        name: {"shape": tensor.shape, "values": tensor.ravel().tolist()}
        for name, tensor in tensors.items()
    }
    make = """(m, answer) => {
        for (const tensor of Object.values(answer)) {
            tensor.values = Float32Array.from(tensor.values);
        }
        const limits = { a_max: 3, v_max: 2, horizon_s: 8 };
        const anchors = new m.Anchors(answer, { conditioning: { limits } });
        const [curvature, limit] = [anchors.curvature(0), anchors.curvatureLimit(0)];
        return [Array.from(curvature), Array.from(limit), anchors.length(0), anchors.trouble];
    }"""

    curvature, limit, length, trouble = call("anchors", make, answer)

    np.testing.assert_allclose(curvature, 0.5, rtol=1e-5)
    np.testing.assert_allclose(limit, 3 / 1.5**2, rtol=1e-5)
    assert length == pytest.approx(2 * 2.0, rel=2e-3)
    assert trouble == ""
