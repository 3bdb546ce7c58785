"""`AnchorRequest.build`: what it makes of good fields, and how it refuses bad ones."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from anchorflow_client import (
    AnchorClient,
    AnchorRequest,
    Codec,
    CostMap,
    InvalidRequest,
    JsonCodec,
    OipCodec,
)
from anchorflow_client.contract import DEFAULT_STYLE, STYLES, TensorSpec
from anchorflow_client.contract.inputs import bind

NAN, INF = float("nan"), float("inf")


def refusal(fields: dict[str, Any]) -> InvalidRequest:
    with pytest.raises(InvalidRequest) as caught:
        AnchorRequest.from_fields(fields)
    return caught.value


def occupied_at(row: int, column: int) -> list[Any]:
    grid = np.zeros((1, 16, 20))
    grid[0, row, column] = 0.5
    return grid.tolist()


def test_the_defaults_are_the_contracts(fields: dict[str, Any]) -> None:
    request = AnchorRequest.from_fields(fields)

    assert request.num_samples is None
    assert not request.batched
    np.testing.assert_array_equal(request.w_style, [DEFAULT_STYLE])
    np.testing.assert_array_equal(request.cost_map.origin, [-5.0, -4.0])
    assert request.seed is None
    assert request.robot_radius is None


def test_null_leaves_an_optional_field_out(fields: dict[str, Any]) -> None:
    request = AnchorRequest.from_fields(fields | {"seed": None, "w_style": None, "sampler": None})

    assert request.seed is None
    assert request.sampler is None


def test_one_batched_field_makes_a_batch_that_shares_the_others(fields: dict[str, Any]) -> None:
    request = AnchorRequest.from_fields(fields | {"x_goal": [fields["x_goal"]] * 3})

    assert request.batched
    assert request.num_scenes == 3
    assert request.cost_map.data.shape == (3, 1, 16, 20)
    assert request.x_curr.shape == (3, 6)
    assert request.w_style.shape == (3, 3)


@pytest.mark.parametrize("name", ["conservative", "balanced", "efficient", "comfortable"])
def test_a_style_may_be_named(fields: dict[str, Any], name: str) -> None:
    named = AnchorRequest.from_fields(fields | {"w_style": name})

    np.testing.assert_array_equal(named.w_style, [STYLES[name]])
    assert named.w_style.sum() == pytest.approx(1.0, abs=1e-15)
    assert not named.batched


def test_a_named_style_is_every_scenes(fields: dict[str, Any]) -> None:
    goals = [fields["x_goal"]] * 3

    named = AnchorRequest.from_fields(fields | {"w_style": "efficient", "x_goal": goals})

    np.testing.assert_array_equal(named.w_style, [STYLES["efficient"]] * 3)


def test_what_each_style_weighs_most() -> None:
    """Safety, energy, smoothness; nothing said is balanced."""
    assert set(STYLES) == {"conservative", "balanced", "efficient", "comfortable"}
    heaviest = {name: int(np.argmax(weights)) for name, weights in STYLES.items()}
    assert (heaviest["conservative"], heaviest["efficient"], heaviest["comfortable"]) == (0, 1, 2)
    assert DEFAULT_STYLE == STYLES["balanced"] == (0.4, 0.3, 0.3)


def test_style_is_made_to_sum_to_one(fields: dict[str, Any]) -> None:
    request = AnchorRequest.from_fields(fields | {"w_style": [[2, 1, 1], [0, 0, 5]]})

    np.testing.assert_allclose(request.w_style, [[0.5, 0.25, 0.25], [0, 0, 1]])


def test_arrays_cannot_be_written_and_the_callers_own_can(fields: dict[str, Any]) -> None:
    mine = np.array(fields["x_curr"])
    request = AnchorRequest.from_fields(fields | {"x_curr": mine})

    with pytest.raises(ValueError, match="read-only"):
        request.x_curr[0, 0] = 1.0
    mine[0] = 9.0
    assert request.x_curr[0, 0] == -3.0


def test_an_input_does_not_change_with_the_array_that_a_read_only_view_is_of() -> None:
    live = np.zeros(3)
    view = live.view()
    view.flags.writeable = False
    request = AnchorRequest.build(inputs={"speed": view})
    live[:] = 1.0

    np.testing.assert_array_equal(np.asarray(request.inputs["speed"]), np.zeros(3))


class OfAnotherLibrary:
    """A tensor that is not on this processor, or whose gradients are wanted."""

    def __init__(self, error: type[Exception]) -> None:
        self._error = error

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        raise self._error("use detach()")


@pytest.mark.parametrize("error", [RuntimeError, TypeError, ValueError])
@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("cost_map", "cost_map.data"),
        ("origin", "cost_map.origin"),
        ("x_curr", "x_curr"),
        ("x_goal", "x_goal"),
        ("w_style", "w_style"),
        ("inputs", "inputs.camera"),
        ("warm_start", "warm_start.trajectory"),
    ],
)
def test_what_cannot_become_an_array_is_named(
    fields: dict[str, Any], name: str, field: str, error: type[Exception]
) -> None:
    tensor: Any = OfAnotherLibrary(error)
    inside: dict[str, Any] = {"inputs": {"camera": tensor}, "warm_start": {"trajectory": tensor}}
    place = {"cost_map": np.zeros((16, 20)), "resolution": 0.5}

    with pytest.raises(InvalidRequest, match=r"use detach\(\)") as caught:
        AnchorClient("http://nobody").plan(**fields | place | {name: inside.get(name, tensor)})
    assert caught.value.field == field


def test_numpy_values_are_as_good_as_lists(fields: dict[str, Any]) -> None:
    occupancy = np.zeros((1, 16, 20), dtype=bool)
    request = AnchorRequest.build(
        cost_map=CostMap.build(occupancy, np.float32(0.5)),
        x_curr=np.array(fields["x_curr"], np.float32),
        x_goal=tuple(fields["x_goal"]),
        num_samples=np.int64(3),
        seed=np.int32(4),
    )

    assert (request.num_samples, request.seed) == (3, 4)
    assert request.cost_map.data.dtype == np.float32


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("x_curr", [0, 0, 0], ["[6] or [B,6]", "[9] or [B,9]", "[3]"]),
        ("x_curr", [[[0] * 6]], ["[6] or [B,6]", "[1, 1, 6]"]),
        ("x_curr", [0, 0, 0, 0, 0, "abc"], ["a number", "the string 'abc'", "x_curr[5]"]),
        ("x_curr", "abc", ["a list of numbers", "the string 'abc'"]),
        ("x_curr", [0, 0, True, 0, 0, 0], ["the boolean true", "x_curr[2]"]),
        ("x_curr", [0, 0, None, 0, 0, 0], ["null", "x_curr[2]"]),
        ("x_curr", [0, 0, {}, 0, 0, 0], ["an object", "x_curr[2]"]),
        ("x_curr", [0, 0, [0], 0, 0, 0], ["a list of 1", "x_curr[2]"]),
        ("x_curr", [[0] * 6, 7], ["a list", "x_curr[1]", "7"]),
        ("x_curr", [[0] * 6, [0] * 5], ["x_curr[1]", "a list of 5"]),
        ("x_curr", [], ["[6] or [B,6]", "[0]"]),
        ("x_curr", [NAN, 0, 0, 0, 0, 0], ["finite", "nan", "x_curr[0]"]),
        ("x_curr", [0, 0, 0, 0, 0, -INF], ["finite", "-inf", "x_curr[5]"]),
        ("x_curr", [10**400, 0, 0, 0, 0, 0], ["finite"]),
        ("x_curr", [1e30, 0, 0, 0, 0, 0], ["[-1e+07, 1e+07] m", "1e+30"]),
        ("x_curr", [0, 0, 0, -500, 0, 0], ["[-100, 100] m/s", "-500.0", "x_curr[3]"]),
        ("x_curr", [[0] * 6, [0] * 5 + [1e4]], ["[-100, 100] m/s^2", "10000.0", "x_curr[1][5]"]),
        ("x_goal", [0, 0, 3000, 0], ["[-100, 100] m/s", "3000.0", "x_goal[2]"]),
        ("x_curr", np.array(["a"] * 6), ["numbers", "<U1"]),
        ("x_curr", np.array(1.0), ["[6] or [B,6]", "[]"]),
        ("x_goal", np.array(np.nan), ["finite", "nan"]),
        ("w_style", np.array(0.5), ["[3] or [B,3]", "[]"]),
        ("cost_map.data", np.array(0.0), ["[C,H,W] or [B,C,H,W]", "[]"]),
        ("cost_map.origin", np.array(0.0), ["[2]", "[]"]),
        ("sampler.schedule", np.array(1.0), ["[K]", "[]"]),
        ("warm_start.trajectory", np.array(1.0), ["[T,2] to [T,6]", "[]"]),
        ("x_curr", [6, 0, 0, 0, 0, 0], ["on the map", "x from -5 to 5", "(6, 0)"]),
        ("x_goal", [0, -4.1, 0, 0], ["on the map", "y from -4 to 4", "(0, -4.1)"]),
        ("x_goal", [0] * 6, ["[4] or [B,4]", "[6]"]),
        ("x_curr", [0] * 8, ["[6] or [B,6]", "[9] or [B,9]", "[8]"]),
        ("w_style", [0.5, -0.1, 0.6], ["-0.1", "w_style[1]"]),
        ("w_style", [0, 0, 0], ["above 0", "zeros"]),
        ("w_style", [1, 1], ["[3] or [B,3]", "[2]"]),
        ("w_style", "fast", ["conservative, balanced, efficient, comfortable", "'fast'"]),
        ("w_style", ["efficient"] * 3, ["number at w_style[0]", "'efficient'"]),
        ("num_samples", 0, ["1 to 512", "0"]),
        ("num_samples", 513, ["1 to 512", "513"]),
        ("num_samples", 64.0, ["integer", "64.0"]),
        ("num_samples", "64", ["integer", "the string '64'"]),
        ("num_samples", True, ["integer", "the boolean true"]),
        ("robot_radius", -0.1, ["[0, 5] m", "-0.1"]),
        ("robot_radius", "wide", ["a number", "'wide'"]),
        ("robot_radius", NAN, ["nan"]),
        ("v_max", 0, ["(0, 100] m/s"]),
        ("a_max", False, ["the boolean false"]),
        ("horizon_s", 10**400, ["an integer of 1329 bits"]),
        ("model", 3, ["a string", "3"]),
        ("model", "", ["1 to 128"]),
        ("request_id", "a\nb", ["printable"]),
        ("seed", -1, ["from 0", "-1"]),
        ("seed", 2**63, ["9223372036854775807", "9223372036854775808"]),
        ("budget_ms", 0, ["ms", "0"]),
        ("sampler", "rk4", ["an object", "'rk4'"]),
        ("sampler.method", "rk5", ["rk4, heun, midpoint, euler", "'rk5'"]),
        ("sampler.schedule", "9step", ["8step", "9step"]),
        ("sampler.schedule", [0, 0.5, 0.5, 1], ["strictly increasing"]),
        ("sampler.schedule", [0, 0.5], ["last time of 1", "0.5"]),
        ("sampler.schedule", [0.2, 1], ["first time of 0", "0.2"]),
        ("sampler.schedule", [1], ["[K]", "[1]"]),
        ("sampler.schedule", {"steps": 4}, ["unknown field"]),
        ("sampler.schedule.uniform", 0, ["1 to 100", "0"]),
        ("refine.smooth", 1, ["true or false", "1"]),
        ("refine.safety_margin", -1, ["[0, 5] m"]),
        ("refine.guidance", "x", ["a number"]),
        ("refine.barrier", "yes", ["true or false", "'yes'"]),
        ("refine.certified_margin", 6, ["[0, 5] m", "6"]),
        ("warm_start.tau", 1, ["(0, 1)", "1"]),
        ("warm_start.dt", 0, ["(0, 600] s", "0"]),
        ("warm_start.dt", "0.1", ["(0, 600] s", "'0.1'"]),
        ("warm_start.dt", [0.1, 0.2], ["(0, 600] s", "a list of 2"]),
        ("warm_start.trajectory", [[0, 0, 0, 0, 0, 0, 0]] * 4, ["[T,2] to [T,6]", "[4, 7]"]),
        ("warm_start.trajectory", None, ["required"]),
        ("cost_map", [[0]], ["an object", "a list of 1"]),
        ("cost_map.data", np.zeros((16, 20)).tolist(), ["[C,H,W] or [B,C,H,W]", "[16, 20]"]),
        ("cost_map.data", np.zeros((1, 8, 20)).tolist(), ["16 to 512", "8 and 20"]),
        ("cost_map.data", np.zeros((17, 16, 16)).tolist(), ["C from 1 to 16", "17"]),
        ("cost_map.channel_weights", [1.0], ["[0], one for each channel but the first", "[1]"]),
        ("cost_penalty", 101, ["[0, 100]", "101"]),
        ("cost_penalty", -0.5, ["[0, 100]", "-0.5"]),
        ("clear_start", 1, ["true or false", "1"]),
        ("goal_tolerance", 0.5, ["an object", "0.5"]),
        ("goal_tolerance.position", -1, ["[0, 100] m", "-1"]),
        ("goal_tolerance.position", None, ["required"]),
        ("goal_tolerance", {"position": 1, "heading": 4}, ["[0, 3.14159] rad", "4"]),
        ("cost_map.data", np.zeros((65, 1, 16, 16)).tolist(), ["B from 1 to 64", "65"]),
        ("cost_map.data", np.full((1, 16, 20), 1.5).tolist(), ["[0, 1]", "1.5"]),
        ("cost_map.data", np.zeros((1, 1, 1, 16, 20)).tolist(), ["deeper"]),
        ("cost_map.resolution", 0, ["[1e-06, 100] m/cell", "0"]),
        ("cost_map.resolution", 1e-40, ["[1e-06, 100] m/cell", "1e-40"]),
        ("cost_map.resolution", None, ["required"]),
        ("cost_map.origin", [0, 0, 0], ["[2]", "[3]"]),
        ("cost_map.origin", [0, INF], ["finite"]),
    ],
)
def test_a_bad_field_is_named_with_what_was_expected_and_what_came(
    fields: dict[str, Any], field: str, value: Any, words: list[str]
) -> None:
    *path, last = field.split(".")
    if path[:1] == ["warm_start"]:
        fields["warm_start"] = {"trajectory": [[0, 0], [1, 1]]}
    parent = fields
    for name in path:
        parent = parent.setdefault(name, {})
    parent[last] = value

    error = refusal(fields)

    named = error.field or ""
    assert named == field or named.startswith(f"{field}.")
    assert named in error.message
    assert [word for word in words if word not in error.message] == []


@pytest.fixture
def heading_fields(fields: dict[str, Any]) -> dict[str, Any]:
    """The same request with a heading: (x, y, heading; their rates; their second rates)."""
    return fields | {
        "x_curr": [-3.0, 0.5, 0.8, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
        "x_goal": [3.0, 0.5, -0.8, 0.1, 0.2, 0.3],
    }


def test_the_length_of_the_state_tells_the_dimensions(
    fields: dict[str, Any], heading_fields: dict[str, Any]
) -> None:
    planar = AnchorRequest.from_fields(fields)
    states = [heading_fields["x_curr"]] * 2
    turning = AnchorRequest.from_fields(heading_fields | {"x_curr": states})

    assert (planar.on_map.dim, turning.on_map.dim) == (2, 3)
    np.testing.assert_array_equal(turning.x_curr, states)
    np.testing.assert_array_equal(turning.x_goal, [heading_fields["x_goal"]] * 2)


def test_a_heading_is_no_place_on_the_map(heading_fields: dict[str, Any]) -> None:
    """The map reaches 5 m, and a velocity 100 m/s; a heading of 600 rad is as good as any."""
    heading_fields["x_curr"][2] = 600.0

    assert AnchorRequest.from_fields(heading_fields).x_curr[0, 2] == 600.0


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("x_goal", [3, 0.5, 0, 0], ["[6] or [B,6]", "got [4]"]),
        ("x_goal", [[3, 0.5, 0, 0]] * 2, ["[6] or [B,6]", "got [2, 4]"]),
        ("x_curr", [-3, 9, 0, 0, 0, 0, 0, 0, 0], ["on the map", "(-3, 9)"]),
        ("x_curr", [0, 0, 0, 0, 0, 500, 0, 0, 0], ["[-100, 100]", "500.0 at x_curr[5]"]),
        ("warm_start", {"trajectory": [[0] * 2] * 4}, ["[T,3] to [T,9]", "[4, 2]"]),
        ("warm_start", {"trajectory": [[0] * 10] * 4}, ["[T,3] to [T,9]", "[4, 10]"]),
    ],
)
def test_with_heading_a_bad_field_is_named_too(
    heading_fields: dict[str, Any], field: str, value: Any, words: list[str]
) -> None:
    error = refusal(heading_fields | {field: value})

    assert (error.field or "").startswith(field)
    assert [word for word in words if word not in error.message] == []


@pytest.mark.parametrize("field", ["cost_map", "x_curr", "x_goal"])
def test_a_missing_field_is_named(fields: dict[str, Any], field: str) -> None:
    del fields[field]

    error = refusal(fields)

    assert error.field == field
    assert "required" in error.message


@pytest.mark.parametrize(
    ("body", "field", "words"),
    [
        ({}, "body", "expected cost_map, x_curr and x_goal, or inputs, got none of them"),
        ({"inputs": {}}, "body", "expected cost_map, x_curr and x_goal, or inputs, got none"),
        ({"inputs": {"a": 1}, "w_style": "efficient"}, "w_style", "expected none for a planner"),
        (
            {"inputs": {"a": 1}, "sampler": {"schedule": [0.5, 1]}},
            "sampler.schedule",
            "first time of 0",
        ),
        ({"inputs": {"a": 10**30}}, "inputs.a", "9223372036854775807, got an integer of 100 bits"),
    ],
)
def test_without_a_map_a_bad_field_is_named_too(
    body: dict[str, Any], field: str, words: str
) -> None:
    error = refusal(body)

    assert error.field == field
    assert words in error.message


@pytest.mark.parametrize(
    ("path", "near"),
    [("x_cur", "x_curr"), ("cost_map.resolutoin", "resolution"), ("refine.smoth", "smooth")],
)
def test_an_unknown_field_is_named_with_the_nearest_known(
    fields: dict[str, Any], path: str, near: str
) -> None:
    *parents, name = path.split(".")
    parent = fields
    for key in parents:
        parent = parent.setdefault(key, {})
    parent[name] = 1

    error = refusal(fields)

    assert error.field == path
    assert f"did you mean {near!r}?" in error.message


@pytest.mark.parametrize("number", [2**53 + 1, -(2**63), 2**63 - 1])
@pytest.mark.parametrize("codec", [JsonCodec(), OipCodec()])
def test_whole_numbers_of_an_input_are_not_rounded(codec: Codec, number: int) -> None:
    request = AnchorRequest.build(inputs={"stamps": [[number, 1], [0.0, 2.0]]})
    came = codec.decode_request(codec.encode_request(request))
    bound, *_ = bind(came.inputs, [TensorSpec("stamps", "int64", ("B", 2))])

    assert np.asarray(bound["stamps"]).tolist() == [[number, 1], [0, 2]]


@pytest.mark.parametrize("number", [1e39, -3.5e38])
def test_an_input_beyond_its_cards_type_is_told_as_it_came(number: float) -> None:
    speeds = TensorSpec("speeds", "float32", ("B", 2))
    words = rf"numbers that float32 holds, got {re.escape(str(number))} at inputs\.speeds\[1\]$"

    for value in ([0.0, number], np.array([0.0, number])):
        with pytest.raises(InvalidRequest, match=f"expected {words}"):
            bind(AnchorRequest.build(inputs={"speeds": value}).inputs, [speeds])
    with pytest.raises(InvalidRequest, match=r"finite numbers, got inf at inputs\.speeds\[1\]$"):
        bind({"speeds": np.array([0.0, np.inf])}, [speeds])


def test_an_input_may_be_the_end_of_its_range_in_the_cards_type() -> None:
    speed = TensorSpec("speed", "float32", ("B", 1), range=(0.0, 1.1))

    bound, *_ = bind(AnchorRequest.build(inputs={"speed": [1.1]}).inputs, [speed])

    np.testing.assert_array_equal(bound["speed"], np.array([[1.1]], np.float32))


def test_an_unknown_option_is_refused_in_python_too(fields: dict[str, Any]) -> None:
    with pytest.raises(InvalidRequest, match="num_sample: unknown field"):
        AnchorRequest.build(**fields, num_sample=3)


def test_one_long_string_costs_no_memory(fields: dict[str, Any]) -> None:
    """numpy alone would pad every number to the string's length: 40 GB here."""
    grid: list[Any] = np.zeros((1, 100, 100)).tolist()
    grid[0][99][99] = "x" * 1_000_000
    fields["cost_map"]["data"] = grid

    assert "cost_map.data[0][99][99]" in refusal(fields).message


def test_batches_must_agree(fields: dict[str, Any]) -> None:
    fields |= {"x_curr": [fields["x_curr"]] * 2, "x_goal": [fields["x_goal"]] * 3}

    error = refusal(fields)

    assert error.field == "x_goal"
    assert "B = 2 as in x_curr, got 3" in error.message


@pytest.mark.parametrize(("field", "column"), [("x_curr", 4), ("x_goal", 16)])
def test_an_occupied_cell_is_named(fields: dict[str, Any], field: str, column: int) -> None:
    fields["cost_map"]["data"] = occupied_at(9, column)

    error = refusal(fields)

    assert error.field == field
    assert f"[row 9, column {column}] of occupancy 0.5" in error.message


def test_each_scene_is_checked_on_its_own_map(fields: dict[str, Any]) -> None:
    fields["cost_map"]["data"] = [occupied_at(0, 0), occupied_at(9, 16)]

    assert "of scene 1" in refusal(fields).message


def test_the_border_of_the_map_belongs_to_it(fields: dict[str, Any]) -> None:
    fields |= {"x_curr": [-5, -4, 0, 0, 0, 0], "x_goal": [5, 4, 0, 0]}

    assert AnchorRequest.from_fields(fields).num_scenes == 1


def test_a_warm_start_may_begin_later(fields: dict[str, Any]) -> None:
    fields |= {
        "sampler": {"schedule": [0.8, 1]},
        "warm_start": {"trajectory": [[0, 0], [1, 1]]},
    }

    request = AnchorRequest.from_fields(fields)

    assert request.warm_start is not None
    assert (request.warm_start.tau, request.warm_start.dt) == (0.8, None)


def test_a_warm_start_may_say_how_far_its_samples_lie_apart(fields: dict[str, Any]) -> None:
    told = {"warm_start": {"trajectory": [[0, 0], [1, 1]], "dt": np.float32(0.5)}}

    request = AnchorRequest.from_fields(fields | told)

    assert request.warm_start is not None
    assert request.warm_start.dt == 0.5
    again = AnchorRequest.from_fields(fields | {"warm_start": request.warm_start}).warm_start
    assert again is not None
    assert again.dt == 0.5


@pytest.mark.parametrize(
    "value",
    [np.zeros((3, 0, 0), np.uint8), np.zeros((3, 0, 5)), np.zeros(0, object), [], [[], []]],
    ids=["picture", "floats", "texts", "list", "lists"],
)
def test_an_input_without_a_number_is_refused(value: Any) -> None:
    shape = list(np.shape(value))
    with pytest.raises(InvalidRequest, match="expected no axis of size 0, got an array") as caught:
        AnchorRequest.build(inputs={"camera": value})
    assert caught.value.field == "inputs.camera"
    assert str(caught.value).endswith(f"and shape {shape}")
