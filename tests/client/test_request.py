"""`AnchorRequest.build`: what it makes of good fields, and how it refuses bad ones."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from bad_fields import BAD_FIELDS, occupied_at, with_value

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


def refusal(fields: dict[str, Any]) -> InvalidRequest:
    with pytest.raises(InvalidRequest) as caught:
        AnchorRequest.from_fields(fields)
    return caught.value


def test_the_defaults_are_the_contracts(fields: dict[str, Any]) -> None:
    request = AnchorRequest.from_fields(fields)

    assert request.num_samples is None
    assert not request.batched
    np.testing.assert_array_equal(request.w_style, [DEFAULT_STYLE])
    np.testing.assert_array_equal(request.cost_map.origin, [-5.0, -4.0])
    assert request.robot_radius is None
    null = AnchorRequest.from_fields(fields | {"seed": None, "w_style": None, "sampler": None})
    assert (null.seed, null.sampler) == (request.seed, request.sampler) == (None, None)


def test_one_batched_field_makes_a_batch_that_shares_the_others(fields: dict[str, Any]) -> None:
    request = AnchorRequest.from_fields(fields | {"x_goal": [fields["x_goal"]] * 3})

    assert request.batched
    assert request.num_scenes == 3
    assert request.cost_map.data.shape == (3, 1, 16, 20)
    assert request.x_curr.shape == (3, 6)
    assert request.w_style.shape == (3, 3)


@pytest.mark.parametrize(
    ("name", "heaviest"),
    [("conservative", 0), ("balanced", 0), ("efficient", 1), ("comfortable", 2)],
)
def test_a_style_may_be_named_for_every_scene(
    fields: dict[str, Any], name: str, heaviest: int
) -> None:
    """The weights are those of safety, energy and smoothness."""
    named = AnchorRequest.from_fields(fields | {"w_style": name})
    batch = AnchorRequest.from_fields(fields | {"w_style": name, "x_goal": [fields["x_goal"]] * 3})

    np.testing.assert_array_equal(named.w_style, [STYLES[name]])
    assert int(named.w_style.argmax()) == heaviest
    assert named.w_style.sum() == pytest.approx(1.0, abs=1e-15)
    assert not named.batched
    np.testing.assert_array_equal(batch.w_style, [STYLES[name]] * 3)
    assert len(STYLES) == 4
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


BAD_FIELDS_WITH_HEADING: list[tuple[str, Any, list[str]]] = [
    ("x_goal", [3, 0.5, 0, 0], ["[6] or [B,6]", "got [4]"]),
    ("x_goal", [[3, 0.5, 0, 0]] * 2, ["[6] or [B,6]", "got [2, 4]"]),
    ("x_curr", [-3, 9, 0, 0, 0, 0, 0, 0, 0], ["on the map", "(-3, 9)"]),
    ("x_curr", [0, 0, 0, 0, 0, 500, 0, 0, 0], ["[-100, 100]", "500.0 at x_curr[5]"]),
    ("warm_start.trajectory", [[0] * 2] * 4, ["[T,3] to [T,9]", "[4, 2]"]),
    ("warm_start.trajectory", [[0] * 10] * 4, ["[T,3] to [T,9]", "[4, 10]"]),
]


@pytest.mark.parametrize(
    ("given", "field", "value", "words"),
    [
        *(("fields", *case) for case in BAD_FIELDS),
        *(("heading_fields", *case) for case in BAD_FIELDS_WITH_HEADING),
    ],
)
def test_a_bad_field_is_named_with_what_was_expected_and_what_came(
    request: pytest.FixtureRequest, given: str, field: str, value: Any, words: list[str]
) -> None:
    fields: dict[str, Any] = request.getfixturevalue(given)

    error = refusal(with_value(fields, field, value))

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


@pytest.mark.parametrize("given", [{}, {"dt": np.float32(0.5)}])
def test_a_warm_start_may_begin_later_and_have_its_own_time_step(
    fields: dict[str, Any], given: dict[str, Any]
) -> None:
    fields |= {"sampler": {"schedule": [0.8, 1]}}
    warm_start: Any = {"trajectory": [[0, 0], [1, 1]], **given}

    for _ in range(2):  # from its fields, and as it was read
        warm_start = AnchorRequest.from_fields(fields | {"warm_start": warm_start}).warm_start
        assert (warm_start.tau, warm_start.dt) == (0.8, given.get("dt"))


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
