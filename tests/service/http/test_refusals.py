"""Bad input over the wire gets the documented code and field, and the service continues."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

NAN, INF = float("nan"), float("inf")


@pytest.fixture(autouse=True)
def _goes_on_serving(service: Any, fields: dict[str, Any]) -> Iterator[None]:
    good = json.dumps(fields).encode()
    yield
    assert service.post(good).status_code == 200


def refusal(answer: Any, status: int, code: str) -> dict[str, str]:
    """The error, whose form and code are the contract's."""
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/json"
    body = answer.json()
    assert list(body) == ["error"]
    assert sorted(body["error"]) == ["code", "field", "message"]
    assert body["error"]["code"] == code
    return body["error"]


def with_value(fields: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    *parents, name = path.split(".")
    parent = fields
    for key in parents:
        parent = parent.setdefault(key, {})
    parent[name] = value
    return fields


def occupied_at(row: int, column: int) -> list[Any]:
    grid = np.zeros((1, 16, 20))
    grid[0, row, column] = 1.0
    return grid.tolist()


BAD_VALUES: dict[str, tuple[str, Any, str]] = {
    "state of five": ("x_curr", [0] * 5, "expected shape [6] or [B,6], [9] or [B,9], got [5]"),
    "goal of six": ("x_goal", [0] * 6, "expected shape [4] or [B,4], got [6]"),
    "flat map": ("cost_map.data", [0.0] * 64, "expected shape [C,H,W] or [B,C,H,W], got [64]"),
    "small map": ("cost_map.data", np.zeros((1, 8, 8)).tolist(), "H and W from 16 to 512"),
    "ragged map": ("cost_map.data", [[[0] * 16] * 15 + [[0] * 3]], "cost_map.data[0][15]"),
    "string in a map": (
        "cost_map.data",
        [[[0] * 15 + ["abc"]] * 16],
        "expected a number at cost_map.data[0][0][15], got the string 'abc'",
    ),
    "null in a map": ("cost_map.data", [[[None] * 16] * 16], "got null"),
    "boolean in a map": ("cost_map.data", [[[0] * 15 + [True]] * 16], "got the boolean true"),
    "negative cost": ("cost_map.data", [[[-1] * 16] * 16], "numbers in [0, 1], got -1.0"),
    "nan in a map": ("cost_map.data", [[[NAN] * 16] * 16], "finite numbers, got nan"),
    "string for a number": ("robot_radius", "abc", "expected a number in [0, 5] m, got the string"),
    "boolean for a number": ("num_samples", True, "expected an integer from 1 to 512, got the bo"),
    "string in a state": ("x_curr", [0, 0, 0, 0, 0, "abc"], "at x_curr[5], got the string 'abc'"),
    "boolean in a state": ("x_curr", [0, 0, 0, 0, 0, False], "got the boolean false"),
    "nan": ("x_goal", [0, 0, NAN, 0], "expected finite numbers, got nan at x_goal[2]"),
    "infinity": ("x_goal", [0, 0, INF, 0], "expected finite numbers, got inf at x_goal[2]"),
    "minus infinity": ("robot_radius", -INF, "got -inf"),
    "500 m/s": ("x_curr", [0, 0, 500, 0, 0, 0], "numbers in [-100, 100] m/s, got 500.0 at x_cu"),
    "10000 m/s^2": ("x_curr", [0, 0, 0, 0, 0, 1e4], "in [-100, 100] m/s^2, got 10000.0 at x_c"),
    "negative style": ("w_style", [0.5, -0.5, 1.0], "got -0.5 at w_style[1]"),
    "style of zeros": ("w_style", [0, 0, 0], "expected a weight above 0, got only zeros"),
    "no samples": ("num_samples", 0, "expected an integer from 1 to 512, got 0"),
    "513 samples": ("num_samples", 513, "expected an integer from 1 to 512, got 513"),
    "no resolution": ("cost_map.resolution", 0, "expected a number in [1e-06, 100] m/cell"),
    "goal in an obstacle": ("cost_map.data", occupied_at(9, 16), "[row 9, column 16]"),
    "start off the map": ("x_curr", [-9, 0, 0, 0, 0, 0], "expected a position on the map"),
    "unknown field": ("x_gaol", [0] * 4, "unknown field; did you mean 'x_goal'?"),
    "nested unknown field": ("cost_map.frame", "map", "unknown field"),
    "deeply unknown field": ("sampler.schedule", {"unifrom": 3}, "did you mean 'uniform'?"),
    "steps of nothing": (
        "sampler.schedule",
        [0, 1e-38, 1],
        "expected times at least 1e-06 apart, got [0.0, 1e-38, 1.0]",
    ),
    "fixed limit": ("v_max", 9.0, "expected 2 m/s, which lines 1.2.3 was made for"),
    "string for a list": ("x_curr", "fast", "got the string 'fast'"),
    "list for an object": ("cost_map", [], "expected an object, got a list of 0"),
    "no map": ("cost_map", None, "this field is required"),
}
FIELD_OF = {
    "goal in an obstacle": "x_goal",
    "deeply unknown field": "sampler.schedule.unifrom",
}


@pytest.mark.parametrize("case", BAD_VALUES)
def test_a_bad_value_is_refused_by_name(service: Any, fields: dict[str, Any], case: str) -> None:
    path, value, words = BAD_VALUES[case]

    error = refusal(service.post(with_value(fields, path, value)), 422, "invalid_request")

    assert error["field"] == FIELD_OF.get(case, path)
    assert error["field"] in error["message"]
    assert words in error["message"]


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b'{"cost_map": {"data": [[[0.0, 0.0', "breaks at position 33 of 33"),
        (b"", "breaks at position 0 of 0"),
        (b'{"x_curr": [1,, 2]}', "breaks at position 14 of 19"),
        (b"\xff\xfe", "body"),
        (b"[" * 100_000, "body"),
        (b'"text"', "expected an object, got the string 'text'"),
        (b"null", "expected an object, got null"),
    ],
)
def test_a_body_that_is_no_json_object_is_refused(service: Any, body: bytes, words: str) -> None:
    error = refusal(service.post(body), 422, "invalid_request")

    assert error["field"] == "body"
    assert words in error["message"]


def test_a_name_that_utf8_cannot_carry_is_refused_like_any_other(service: Any) -> None:
    """Only the slow parser, which NaN calls in, lets a lone surrogate through."""
    error = refusal(service.post(b'{"seed": NaN, "\\ud800": 1}'), 422, "invalid_request")

    assert error["field"] == "\\ud800"


def test_a_good_request_cut_anywhere_is_refused(service: Any, fields: dict[str, Any]) -> None:
    body = json.dumps(fields).encode()

    for end in range(1, len(body), len(body) // 7):
        assert refusal(service.post(body[:end]), 422, "invalid_request")["field"] == "body"


def test_an_unknown_model_is_told_what_there_is(service: Any, fields: dict[str, Any]) -> None:
    error = refusal(service.post(fields | {"model": "flowmp"}), 404, "unknown_model")

    assert error["field"] == "model"
    assert "bows, lines" in error["message"]
    assert "'flowmp'" in error["message"]


@pytest.mark.parametrize("content_type", ["application/x-tensor", "text/plain", ""])
def test_another_form_than_json_is_refused(service: Any, content_type: str) -> None:
    headers = {"Content-Type": content_type}
    answer = service.request("POST", "/anchors", headers=headers, content=b"{}")

    error = refusal(answer, 422, "invalid_request")
    assert error["field"] == "Content-Type"
    assert "application/json" in error["message"]


@pytest.mark.parametrize("path", ["/anchors", "/v2/models/lines/infer"])
def test_a_body_that_would_have_to_be_unpacked_is_refused(service: Any, path: str) -> None:
    answer = service.request("POST", path, headers={"Content-Encoding": "gzip"}, content=b"\x1f")

    error = refusal(answer, 422, "invalid_request")
    assert error["field"] == "Content-Encoding"
    assert "expected a body as it is, got 'gzip'" in error["message"]


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/nowhere", 404),
        ("GET", "/anchors", 405),
        ("POST", "/anchors/", 404),
        ("POST", "/v2/models", 405),
    ],
)
def test_a_wrong_path_or_method_is_refused_in_the_same_words(
    service: Any, method: str, path: str, status: int
) -> None:
    error = refusal(service.request(method, path), status, "invalid_request")

    assert f"{method} {path}" in error["message"]


def test_a_long_path_is_not_repeated(service: Any) -> None:
    error = refusal(service.request("GET", "/" + "x" * 10_000), 404, "invalid_request")

    assert len(error["message"]) < 200
