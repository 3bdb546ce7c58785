"""One scene: what follows from its map, when it is worked out, and as what a network is told it."""

from dataclasses import replace

import numpy as np
import pytest

from anchorflow_trajectory import clearance, geodesic
from anchorflow_trajectory.scene import SCENE_INPUTS, Scene, with_neutral_channels


@pytest.fixture
def scene() -> Scene:
    """4 x 3 m from (1, 2) with a wall that has one gap, its occupancy on either side of 0.5."""
    occupancy = np.zeros((1, 30, 40), np.float32)
    occupancy[0, :24, 18:21], occupancy[0, 0, 0] = 0.5, 0.49
    return Scene(
        cost_map=with_neutral_channels(occupancy, 4),
        resolution=0.1,
        origin=np.array([1.0, 2.0]),
        robot_radius=0.2,
        x_curr=np.array([1.5, 3.0, 0.1, 0.2, 0.3, 0.4]),
        x_goal=np.array([4.5, 3.0, 0.0, 0.0]),
        w_style=np.array([0.4, 0.3, 0.3]),
    )


def test_fields_follow_from_the_map(scene: Scene) -> None:
    assert scene.occupied.sum() == 24 * 3
    field = clearance.clearance_field(scene.occupied, 0.1, 0.2)
    np.testing.assert_array_equal(scene.clearance_field, field)
    ways = geodesic.cost_to_go(field, 0.1, scene.origin, scene.x_curr[:2], scene.x_goal[:2])
    np.testing.assert_array_equal(scene.cost_to_go, ways)
    assert ways[1, 10, 5] > 3.5  # the straight way is 3 m long and barred
    assert scene.map_geometry.tolist() == pytest.approx([1.0, 2.0, 0.1])
    np.testing.assert_array_equal(scene.cost_fields.clearance.values, field)
    assert scene.cost_fields.soft is None


def test_a_field_is_worked_out_once_and_anew_for_another_scene(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[float] = []
    real = clearance.clearance_field

    def counted(occupied: np.ndarray, resolution: float, robot_radius: float) -> np.ndarray:
        calls.append(robot_radius)
        return real(occupied, resolution, robot_radius)

    monkeypatch.setattr(clearance, "clearance_field", counted)
    assert scene.cost_to_go is scene.cost_to_go
    assert scene.cost_fields.clearance.values is scene.clearance_field
    wider = replace(scene, robot_radius=0.3)
    np.testing.assert_allclose(wider.clearance_field[10, 25], scene.clearance_field[10, 25] - 0.1)
    assert calls == [0.2, 0.3]


def test_inputs_are_float32_with_a_batch_axis(scene: Scene) -> None:
    inputs = scene.inputs(SCENE_INPUTS)
    assert tuple(inputs) == SCENE_INPUTS
    assert {array.dtype for array in inputs.values()} == {np.dtype(np.float32)}
    assert {name: array.shape for name, array in inputs.items()} == {
        "cost_map": (1, 4, 30, 40),
        "map_geometry": (1, 3),
        "clearance_field": (1, 30, 40),
        "cost_to_go": (1, 2, 30, 40),
        "x_curr": (1, 6),
        "x_goal": (1, 4),
        "w_style": (1, 3),
    }
    assert list(scene.inputs(["x_goal"])) == ["x_goal"]


def test_what_is_left_out_is_neutral() -> None:
    given = np.random.default_rng(0).random((2, 5, 6))
    filled = with_neutral_channels(given, 4)
    assert filled.dtype == np.float32
    np.testing.assert_array_equal(filled[:2], given.astype(np.float32))
    assert not filled[2:].any()
    assert (with_neutral_channels(given[:1], 3)[1] == 1.0).all()
    assert with_neutral_channels(given, 1).shape == (2, 5, 6)


@pytest.mark.parametrize(
    ("point", "free"),
    [
        ((1.5, 3.0), True),
        ((1.0, 3.0), True),
        ((5.0, 5.0), True),  # the map's upper corner belongs to its last cell
        ((5.01, 3.0), False),
        ((0.99, 3.0), False),
        ((2.9, 3.0), False),  # in the wall
        ((2.9, 4.7), True),  # in its gap
    ],
)
def test_free_ground_is_the_map_with_its_border_and_without_obstacles(
    scene: Scene, point: tuple[float, float], free: bool
) -> None:
    assert scene.is_free(np.array(point)) is free
