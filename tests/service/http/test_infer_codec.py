"""Tensors with their numbers in the JSON of a request to `…/infer`."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from anchorflow_client import InvalidRequest, Payload
from anchorflow_service.http.infer_codec import MAX_ENTRIES, InferCodec

BEYOND_FLOAT64 = 2**53 + 1


def read(datatype: str, data: Any, shape: list[int]) -> Any:
    tensor = {"name": "a", "datatype": datatype, "shape": shape, "data": data}
    body = json.dumps({"inputs": [tensor]}).encode()
    return InferCodec().decode_request(Payload(body)).inputs["a"]


@pytest.mark.parametrize(
    ("datatype", "dtype", "data"),
    [
        ("INT64", np.int64, [BEYOND_FLOAT64, -(2**63)]),
        ("INT64", np.int64, [2**63 - 1, 1.0]),
        ("UINT8", np.uint8, [0, 255]),
        ("BOOL", np.bool_, [True, False]),
        ("BOOL", np.bool_, [1, 0]),
        ("FP64", np.float64, [BEYOND_FLOAT64, 0.5]),
        ("FP32", np.float32, [0.1, -3e38]),
    ],
)
def test_numbers_are_those_that_were_sent(datatype: str, dtype: type, data: list[Any]) -> None:
    flat, nested = read(datatype, data, [2]), read(datatype, [[each] for each in data], [2, 1])

    assert flat.dtype == nested.dtype == dtype
    np.testing.assert_array_equal(flat, np.array(data, dtype))
    np.testing.assert_array_equal(nested[:, 0], flat)


@pytest.mark.parametrize(
    ("datatype", "data", "words"),
    [
        ("FP32", [0.0, 1e300], r"expected numbers that FP32 holds, got 1e\+300 at a\[1\]"),
        ("FP64", [0.0, 10**400], "a: expected finite numbers, got one beyond float64"),
        ("INT64", [0, 2**63], r"expected numbers that INT64 holds, got 9\.22\d*e\+18 at a\[1\]"),
        ("INT64", [0, 0.5], r"expected numbers that INT64 holds, got 0\.5 at a\[1\]"),
        ("UINT8", [0, 300], r"expected numbers that UINT8 holds, got 300\.0 at a\[1\]"),
        ("BOOL", [0, 2], r"expected numbers that BOOL holds, got 2\.0 at a\[1\]"),
        ("BOOL", [True, 0], r"expected a number at a\[0\], got the boolean true"),
        ("BOOL", [[True], [True, False]], r"expected a list of 1 like the first at a\[1\]"),
        ("UINT8", [True, False], r"expected a number at a\[0\], got the boolean true"),
    ],
)
def test_a_number_that_its_type_does_not_hold_is_refused(
    datatype: str, data: list[Any], words: str
) -> None:
    with pytest.raises(InvalidRequest, match=f"^{words}"):
        read(datatype, data, [2])


@pytest.mark.parametrize("field", ["inputs", "outputs", "parameters"])
def test_a_crowd_of_entries_is_refused_before_any_is_read(field: str) -> None:
    """The reader takes some 50 µs for each, and 16 MiB hold hundreds of thousands."""
    names = [f"a{index}" for index in range(MAX_ENTRIES + 1)]
    entries = (
        {name: [] for name in names} if field == "parameters" else [{"odd": each} for each in names]
    )
    body = json.dumps({"inputs": []} | {field: entries}).encode()

    with pytest.raises(InvalidRequest, match=rf"^{field}: expected at most 64 entries, got 65$"):
        InferCodec().decode_request(Payload(body))
