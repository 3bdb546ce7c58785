"""The page's own arithmetic, module by module, inside the browser that runs it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from anchorflow_client.contract import TensorSpec
from anchorflow_client.contract.inputs import bind, read_inputs

pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

KINDS = ("forest", "rooms", "city", "maze", "empty")


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
        answer.dt = 0.1;
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


def test_x_is_up_and_y_is_to_the_left(call: Callable[..., Any]) -> None:
    make = """(m) => {
        const canvas = document.createElement("canvas");
        document.body.append(canvas);
        canvas.style.cssText = "width: 400px; height: 300px";
        const eye = new m.BirdsEye(canvas);
        return [[0, 0], [1, 0], [0, 1]].map(([x, y]) => eye.toScreen(x, y));
    }"""

    ego, ahead, left = np.array(call("tensors/birds_eye", make))

    assert (ahead - ego)[0] == 0
    assert (ahead - ego)[1] < 0
    assert (left - ego)[0] < 0
    assert (left - ego)[1] == 0


@pytest.mark.parametrize("metres", [0.0, 5e6])
def test_lines_lie_where_single_points_do(call: Callable[..., Any], metres: float) -> None:
    points = metres + np.array([[0.0, 0.0], [3.0, -4.0], [-2.5, 7.0]])
    make = """(m, [points, metres]) => {
        const toScreen = (x, y) => [200 - 50 * (y - metres), 100 - 50 * (x - metres)];
        return Array.from(m.toScreen({ toScreen }, Float64Array.from(points.flat())));
    }"""

    screen = np.array(call("lines", make, [points.tolist(), metres])).reshape(-1, 2)

    expected = [200, 100] - 50 * (points - metres)[:, ::-1]
    np.testing.assert_allclose(screen, expected, atol=1e-3)


def test_what_rounds_to_0_has_no_sign(call: Callable[..., Any]) -> None:
    make = "(m, values) => values.map((value) => m.figure(value))"
    told = call("dom", make, [-0.004, 0, -0.006, -12.5, 3])
    assert told == ["0.00", "0.00", "−0.01", "−12.50", "3.00"]


@pytest.mark.parametrize(
    ("dtype", "limits", "value"),
    [
        ("float32", None, 0),
        ("uint8", (3, None), 3),
        ("int64", (None, -2), -2),
        ("float64", (-1, 1), 0),
        ("bool", None, 0),
    ],
)
def test_an_input_that_is_left_alone_is_what_its_card_takes(
    call: Callable[..., Any], dtype: str, limits: tuple[int | None, int | None] | None, value: int
) -> None:
    spec = TensorSpec("grid", dtype, ("B", 2, 70), range=limits)

    sent = call("tensors/tensor", "(m, spec) => m.filled(spec)", asdict(spec))

    bound, num_scenes, _ = bind(read_inputs({"grid": sent}), [spec])
    assert num_scenes == 1
    np.testing.assert_array_equal(bound["grid"], np.full((1, 2, 70), value))


def test_the_strongest_class_of_a_picture_is_shown(call: Callable[..., Any]) -> None:
    logits = np.random.default_rng(0).normal(size=(5, 4, 6))
    palette = [[10 * k, 20 * k, 30 * k] for k in range(5)]
    make = """(m, [logits, palette]) => {
        const tensor = { shape: [5, 4, 6], values: logits.flat(2) };
        const raster = new m.Raster({ range: null }, tensor, palette);
        const { width, height } = raster;
        const { data } = raster.canvas.getContext("2d").getImageData(0, 0, width, height);
        return [Array.from(data), raster.classes];
    }"""

    data, classes = call("tensors/raster", make, [logits.tolist(), palette])

    strongest = logits.argmax(0)
    shown = np.array(data).reshape(4, 6, 4)
    np.testing.assert_array_equal(shown[..., :3], np.array(palette)[strongest])
    assert classes == np.unique(strongest).tolist()


def test_layers_cover_each_other_as_much_as_their_values_say(call: Callable[..., Any]) -> None:
    values = np.random.default_rng(0).integers(0, 256, (4, 3, 5))
    palette = [[10, 250, 30], [200, 20, 90]]
    make = """(m, [values, palette]) => {
        const tensor = { shape: [4, 3, 5], values: values.flat(2) };
        const raster = new m.Raster({ range: [0, 255] }, tensor, palette, true);
        return Array.from(raster.canvas.getContext("2d").getImageData(0, 0, 5, 3).data);
    }"""

    data = call("tensors/raster", make, [values.tolist(), palette])

    expected = np.zeros((3, 5, 3))
    for channel, shares in enumerate(values / 255):
        expected += shares[..., None] * (np.array(palette[channel % 2]) - expected)
    np.testing.assert_allclose(np.reshape(data, (3, 5, 4))[..., :3], expected, atol=0.51)
