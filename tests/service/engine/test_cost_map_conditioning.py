"""A request's scenes become the inputs of an encode graph."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from asked_engine import Build

from anchorflow_client.contract import AnchorRequest, resolve_for_card
from anchorflow_service.bundle import Bundle, load_bundle
from anchorflow_service.engine.conditioning.cost_map import CostMapConditioning, MapScene
from anchorflow_trajectory.scene import SCENE_INPUTS


@pytest.fixture
def tiny(tiny_bundle: Path) -> Bundle:
    return load_bundle(tiny_bundle)


def scenes(request: AnchorRequest, bundle: Bundle) -> list[MapScene]:
    return CostMapConditioning(bundle.manifest).scenes(resolve_for_card(request, bundle.card))


def test_every_input_has_the_shape_that_its_name_stands_for(
    tiny: Bundle, small_request: Build
) -> None:
    (scene,) = scenes(small_request(), tiny)
    inputs = scene.inputs(SCENE_INPUTS)
    assert {name: array.shape for name, array in inputs.items()} == {
        "cost_map": (1, 3, 64, 64),
        "map_geometry": (1, 3),
        "clearance_field": (1, 64, 64),
        "x_curr": (1, 6),
        "x_goal": (1, 4),
        "w_style": (1, 3),
        "limits": (1, 4),
        "route_states": (1, 2, 8, 7),
    }
    assert all(array.dtype == np.float32 for array in inputs.values())
    np.testing.assert_array_equal(inputs["map_geometry"], [[-4.0, -4.0, 0.125]])
    np.testing.assert_allclose(inputs["w_style"], [[0.4, 0.3, 0.3]])
    np.testing.assert_array_equal(inputs["limits"], [[2.0, 3.0, 0.25, 7.0]])


def test_limits_are_the_requests(free_bundle: Path, small_request: Build) -> None:
    bundle = load_bundle(free_bundle)
    asked = {"v_max": 0.26, "a_max": 0.5, "robot_radius": 0.1}
    for horizon_s in (None, 40.0):
        (scene,) = scenes(small_request(**asked, horizon_s=horizon_s), bundle)
        expected = [[0.26, 0.5, 0.1, horizon_s or 0.0]]
        np.testing.assert_allclose(scene.inputs(["limits"])["limits"], expected)


def test_the_certified_margin_is_the_routes_too(tiny: Bundle, small_request: Build) -> None:
    (asked,) = scenes(small_request(refine={"certified_margin": 0.2}), tiny)
    (plain,) = scenes(small_request(), tiny)
    assert (asked.scene.certified_margin, plain.scene.certified_margin) == (0.2, 0.0)


def with_heading(bundle: Bundle) -> Bundle:
    answer = replace(bundle.card.answer, components=("x", "y", "heading"))
    return replace(bundle, card=replace(bundle.card, answer=answer))


def test_with_heading_the_map_sees_x_and_y_alone(tiny: Bundle, small_request: Build) -> None:
    states = {
        "x_curr": [-3.0, 0.1, 1.5, 0.5, 0.0, 0.1, 0.0, 0.0, 0.1],
        "x_goal": [3.0, 0.2, -9.0, 0.0, 0.0, 0.0],
    }
    (turning,) = scenes(small_request(**states), with_heading(tiny))
    (planar,) = scenes(small_request(), tiny)
    inputs = turning.inputs(["x_curr", "x_goal"])
    assert {name: array.shape for name, array in inputs.items()} == {
        "x_curr": (1, 9),
        "x_goal": (1, 6),
    }
    (own,), (plain,) = (
        scene.inputs(["route_states"])["route_states"] for scene in (turning, planar)
    )
    assert own.shape == (2, 8, 10)
    np.testing.assert_allclose(own[..., [0, 1, 9]], plain[..., [0, 1, 6]], atol=1e-5)
    np.testing.assert_allclose(own[:, [0, -1], 2], [[1.5, -9.0]] * 2, atol=1e-4)


def test_all_scenes_have_the_same_discs_and_none_without_obstacles(
    tiny: Bundle, small_request: Build
) -> None:
    start = small_request().x_curr[0]
    track = {"position": [[1.0, 0.5]], "velocity": [[0.0, -1.0]], "radius": [0.3], "growth": 0.1}

    first, second = scenes(small_request(x_curr=[start, start], obstacles=track), tiny)
    (free,) = scenes(small_request(), tiny)

    assert first.scene.movers is second.scene.movers
    assert first.scene.movers is not None
    np.testing.assert_array_equal(first.scene.movers.places, [[[1.0, 0.5], [1.0, -0.5]]])
    assert (first.scene.movers.radius.tolist(), first.scene.movers.growth) == ([0.3], 0.1)
    assert free.scene.movers is None


def test_coarse_cells_are_cut_where_something_moves_among_walls(
    tiny: Bundle, small_request: Build
) -> None:
    track = {"position": [[1.0, 0.5]], "velocity": [[0.0, -1.0]], "radius": [0.3]}
    walls, found = np.zeros((1, 64, 64), np.float32), {}
    walls[0, 4:8, 4:8] = 1.0
    for name, cells in {"open": 0.0 * walls, "walls": walls}.items():
        for who in (None, track):
            cost_map = {"data": cells, "resolution": 0.15}
            (made,) = scenes(small_request(cost_map=cost_map, obstacles=who), tiny)
            found[name, who is not None] = made.scene.resolution
    assert found == {key: 0.075 if key == ("walls", True) else 0.15 for key in found}


def test_only_what_the_manifest_lists_is_made(tiny: Bundle, small_request: Build) -> None:
    (scene,) = scenes(small_request(), tiny)
    names = tiny.manifest.graphs["encode"].input_names
    assert list(scene.inputs(names)) == ["cost_map", "x_curr"]
    assert "clearance_field" not in scene.scene.__dict__


def test_a_scene_has_every_channel_with_its_weight(tiny: Bundle, small_request: Build) -> None:
    data = np.zeros((16, 16, 16))
    data[15] = 0.5
    cost_map = {"data": data, "resolution": 0.5, "channel_weights": [2.0] * 15}

    (scene,) = scenes(small_request(cost_map=cost_map, cost_penalty=0.0), tiny)

    assert scene.scene.cost_map.shape == (16, 64, 64)  # its cells of 0.5 m are cut
    assert (scene.scene.cost_map[15] == 0.5).all()
    assert scene.scene.channel_weights is not None
    assert scene.scene.channel_weights.tolist() == [2.0] * 15
    assert scene.scene.cost_penalty == 0.0


def test_denormal_numbers_are_no_soft_cost(tiny: Bundle, small_request: Build) -> None:
    """Case V2: a map of 1e-40, with which a request took 1.3 times as long."""
    data = np.full((3, 16, 16), 1e-40, np.float32)
    data[0, 3, 3], data[1], data[2, 5, 5] = 1.0, 1.0, 1e-5

    (scene,) = scenes(small_request(cost_map={"data": data, "resolution": 0.5}), tiny)

    assert scene.scene.surcharge is not None
    assert np.count_nonzero(scene.scene.surcharge) == 16  # the parts of one cell
    assert np.count_nonzero(scene.scene.network_map[[0, 2]]) == 2 * 16


def test_each_scene_of_a_batch_sees_its_own_map_and_state(
    tiny: Bundle, small_request: Build
) -> None:
    maps = np.zeros((2, 1, 16, 16))
    maps[1, 0, 3, 3] = 1.0
    x_curr = [[-3.0, 0.1, 0.0, 0.0, 0.0, 0.0], [-2.0, 0.1, 0.0, 0.0, 0.0, 0.0]]
    request = small_request(cost_map={"data": maps, "resolution": 0.5}, x_curr=x_curr)
    first, second = scenes(request, tiny)
    assert not first.scene.occupied.any()
    rows, columns = np.nonzero(second.scene.occupied)
    assert {*rows.tolist()} == {*columns.tolist()} == {12, 13, 14, 15}
    assert (first.scene.x_curr[0], second.scene.x_curr[0]) == (-3.0, -2.0)
