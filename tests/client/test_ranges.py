"""Intervals: one number, all of many, and each of many are held against the same ends."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from anchorflow_client.contract.checks import SCALAR_COMPARISONS, Interval

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
