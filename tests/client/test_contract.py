"""Parts of the contract: intervals, the cost map's geometry, the model card, and the error tree."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from anchorflow_client import CostMap, ModelCard, errors
from anchorflow_client.contract.checks import SCALAR_COMPARISONS, Interval
from anchorflow_client.errors import InvalidAnswer, InvalidRequest, Overloaded, RequestError

ENDS = st.sampled_from([-math.inf, -1.0, 0.0, 1.0, math.inf])
INTERVALS = st.builds(
    Interval, low=ENDS, high=ENDS, open_low=st.booleans(), open_high=st.booleans()
)
NUMBERS = st.one_of(st.sampled_from([-1.0, -0.0, 0.0, 1.0]), st.floats(width=32))


@given(INTERVALS, hnp.arrays(np.float32, hnp.array_shapes(min_side=0), elements=NUMBERS))
def test_all_lie_inside_where_each_does(
    interval: Interval, values: np.ndarray[tuple[int, ...], np.dtype[np.float32]]
) -> None:
    inside = interval.contains(values)

    assert interval.holds_all(values) == inside.all()
    assert [interval.holds(value) for value in values.flat] == inside.ravel().tolist()


@pytest.mark.parametrize("size", [1, SCALAR_COMPARISONS, SCALAR_COMPARISONS + 1])
@pytest.mark.parametrize("end", [0.1, 0.3, 1.1, 4.7])
def test_an_end_is_met_in_float32_too(size: int, end: float) -> None:
    values = np.full(size, end, np.float32)

    for interval in (Interval(end, 5.0), Interval(0.0, end)):
        assert interval.holds_all(values)
        assert interval.contains(values).all()
        assert not interval.holds_all(np.where(np.arange(size) == 0, np.nan, values))


@pytest.mark.parametrize("number", [10**400, -(10**400)])
def test_an_integer_beyond_every_float_lies_outside(number: int) -> None:
    assert not Interval(-1.0, 1.0).holds(number)


SHAPE = (16, 20)


def cost_map(resolution: float = 0.5, origin: tuple[float, float] | None = None) -> CostMap:
    return CostMap.build(np.zeros((1, *SHAPE)), resolution, origin)


def test_the_row_grows_with_y_and_the_column_with_x() -> None:
    grid = cost_map(origin=(0.0, 0.0))

    assert grid.cell_of(0.1, 0.1) == (0, 0)
    assert grid.cell_of(0.1, 7.9) == (15, 0)
    assert grid.cell_of(9.9, 0.1) == (0, 19)


@given(
    row=st.integers(0, SHAPE[0] - 1),
    column=st.integers(0, SHAPE[1] - 1),
    resolution=st.floats(0.01, 10),
    origin=st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)),
)
def test_the_centre_of_a_cell_lies_in_it(
    row: int, column: int, resolution: float, origin: tuple[float, float]
) -> None:
    grid = cost_map(resolution, origin)
    centre = grid.origin + resolution * np.array([column + 0.5, row + 0.5])

    assert grid.cell_of(*centre) == (row, column)
    assert grid.contains(*centre)


def test_a_map_does_not_change_with_the_array_that_a_read_only_view_is_of() -> None:
    live = np.zeros((1, *SHAPE), np.float32)
    view = live.view()
    view.flags.writeable = False
    grid = CostMap.build(view, 0.5)
    live[:] = 1.0

    assert grid.data.max() == 0.0


def test_what_nobody_can_write_to_is_not_copied() -> None:
    memory = memoryview(bytes(4 * 16 * 20))
    data = np.frombuffer(memory, np.float32).reshape(1, *SHAPE)
    grid = CostMap.build(data, 0.5)

    assert np.shares_memory(grid.data, data)
    assert np.shares_memory(CostMap.from_fields(grid).data, data)
    changing = np.frombuffer(memoryview(bytearray(memory)).toreadonly(), np.float32)
    assert not np.shares_memory(CostMap.build(changing.reshape(1, *SHAPE), 0.5).data, changing)


def test_what_a_mask_hides_is_looked_at() -> None:
    data = np.ma.masked_array(np.zeros((1, *SHAPE), np.float32), mask=False)
    data[0, 3, 4] = np.ma.masked
    data.data[0, 3, 4] = np.nan

    with pytest.raises(InvalidRequest, match=r"finite numbers, got nan at cost_map.data\[0\]\[3\]"):
        CostMap.build(data, 0.5)


def test_a_point_far_away_is_in_the_nearest_cell_however_fine_the_map() -> None:
    grid = cost_map(resolution=1e-6)

    assert grid.cell_of(1e7, -1e7) == (0, 19)


def test_a_card_comes_back_as_it_went(card: ModelCard, free: ModelCard) -> None:
    for each in (card, free):
        assert ModelCard.from_dict(json.loads(json.dumps(each.to_dict()))) == each
    assert free.cost_map.ranges["v_max"] == (0.1, 6.0)
    assert (free.time.dt, free.cost_map.limits.horizon_s) == (None, None)


def test_a_card_without_ranges_lets_nothing_change(card: ModelCard) -> None:
    fields = card.to_dict()
    del fields["conditioning"]["ranges"]

    assert ModelCard.from_dict(fields).cost_map.ranges == {}


def test_a_later_services_keys_are_left_out(card: ModelCard) -> None:
    fields: dict[str, Any] = card.to_dict() | {"ready": True}
    conditioning = fields["conditioning"]
    parts = [conditioning, conditioning["limits"], *(fields[name] for name in ("time", "answer"))]
    for part in (*parts, fields["sampler"], fields["finish"], fields["inputs"][0]):
        part["later"] = 1

    assert ModelCard.from_dict(fields) == card


def test_a_missing_key_is_named(card: ModelCard) -> None:
    fields = card.to_dict()
    del fields["sampler"]

    with pytest.raises(KeyError, match="sampler"):
        ModelCard.from_dict(fields)


CONTRACT = {
    "invalid_request": (errors.InvalidRequest, 422),
    "unknown_model": (errors.UnknownModel, 404),
    "too_large": (errors.TooLarge, 413),
    "unauthorized": (errors.Unauthorized, 401),
    "overloaded": (errors.Overloaded, 429),
    "superseded": (errors.Superseded, 409),
    "deadline_exceeded": (errors.DeadlineExceeded, 504),
    "not_ready": (errors.NotReady, 503),
    "internal": (errors.InternalError, 500),
}


@pytest.mark.parametrize("code", CONTRACT)
def test_every_code_comes_back_as_its_class(code: str) -> None:
    kind, status = CONTRACT[code]
    sent = kind("expected this, got that", "x_goal")

    came = RequestError.from_dict(sent.to_dict())

    assert type(came) is kind
    assert (came.code, came.http_status, came.field) == (code, status, "x_goal")
    assert str(came) == str(sent) == "x_goal: expected this, got that"


def test_a_message_that_names_its_field_is_left_alone() -> None:
    assert str(InvalidRequest("expected a number at x_curr[2]", "x_curr")).count("x_curr") == 1


def test_a_field_inside_a_longer_word_does_not_name_it() -> None:
    assert str(InvalidRequest("did you mean 'x_curr'?", "x_cur")).startswith("x_cur: ")
    assert str(InvalidRequest("see cost_map.data", "cost_map")).startswith("cost_map: ")


@pytest.mark.parametrize(
    ("header", "told", "retry_after_s"),
    [
        (3.0, None, 3.0),
        (None, 3, 3),
        *((None, told, None) for told in (None, "3", True, -1, math.nan, math.inf, 10**400)),
    ],
)
def test_overloaded_says_when_to_come_back(
    header: float | None, told: Any, retry_after_s: float | None
) -> None:
    came = RequestError.from_dict(
        Overloaded("full", retry_after_s=told).to_dict(), retry_after_s=header
    )

    assert isinstance(came, Overloaded)
    assert came.retry_after_s == retry_after_s


def test_a_later_services_code_is_kept() -> None:
    answer = {"error": {"code": "too_cold", "message": "warm up", "field": None}}

    came = RequestError.from_dict(answer, http_status=418)

    assert (came.code, came.http_status) == ("too_cold", 418)


@pytest.mark.parametrize("answer", [[], {}, {"error": "no"}, {"error": {"code": 1, "message": ""}}])
def test_what_is_not_the_contracts_is_an_invalid_answer(answer: Any) -> None:
    with pytest.raises(InvalidAnswer):
        RequestError.from_dict(answer)
