"""Bad input and failures get the documented code and field, and the service continues."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bad_fields import BAD_FIELDS, NOT_JSON, occupied_at, with_value

from anchorflow_client import AnchorBatch


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


IN_JSON = [case for case in BAD_FIELDS if not isinstance(case[1], np.ndarray)]


def test_bad_values_are_refused_by_name(service: Any, fields: dict[str, Any]) -> None:
    for path, value, words in IN_JSON:
        wrong = with_value(copy.deepcopy(fields), path, value)
        error = refusal(service.post(wrong), 422, "invalid_request")
        assert f"{error['field']}.".startswith(f"{path}."), (path, error)
        assert all(word in error["message"] for word in (*words, error["field"])), (path, error)


@pytest.mark.parametrize(
    ("path", "value", "field", "words"),
    [
        ("cost_map.data", occupied_at(9, 16), "x_goal", "[row 9, column 16]"),
        ("v_max", 9.0, "v_max", "expected 2 m/s, which lines 1.2.3 was made for"),
    ],
)
def test_what_the_map_or_the_model_forbids_is_refused_by_name(
    service: Any, fields: dict[str, Any], path: str, value: Any, field: str, words: str
) -> None:
    error = refusal(service.post(with_value(fields, path, value)), 422, "invalid_request")

    assert error["field"] == field
    assert words in error["message"]


@pytest.mark.parametrize(
    ("body", "words"),
    [(b"", "position 0 of 0"), (b"[" * 60_000, "depth limit exceeded"), *NOT_JSON.items()],
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


@pytest.mark.parametrize("content_type", ["application/x-tensor", "text/plain", ""])
def test_another_form_than_json_is_refused(service: Any, content_type: str) -> None:
    headers = {"Content-Type": content_type}
    answer = service.request("POST", "/anchors", headers=headers, content=b"{}")

    error = refusal(answer, 422, "invalid_request")
    assert error["field"] == "Content-Type"
    assert "application/json" in error["message"]


def test_another_form_of_arrays_than_base64_is_refused(
    service: Any, fields: dict[str, Any]
) -> None:
    headers = {"Accept": "text/html, application/json; arrays=hex"}

    content = json.dumps(fields).encode()
    answer = service.request("POST", "/anchors", headers=headers, content=content)
    error = refusal(answer, 422, "invalid_request")
    assert error["field"] == "Accept"
    assert "expected application/json; arrays=base64, got arrays=hex" in error["message"]


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


def explode(_: AnchorBatch) -> AnchorBatch:
    raise ZeroDivisionError("secret detail")


def answer_nan(batch: AnchorBatch) -> AnchorBatch:
    broken = batch.trajectories * np.float32(np.nan)
    return replace(batch, arrays={**batch.arrays, "trajectories": broken})


def answer_infinite_clearance(batch: AnchorBatch) -> AnchorBatch:
    broken = np.full_like(batch.clearance, np.inf)
    return replace(batch, arrays={**batch.arrays, "clearance": broken})


@pytest.mark.parametrize(
    ("fault", "logged"),
    [
        (explode, "secret detail"),
        (answer_nan, "not finite"),
        (answer_infinite_clearance, "not finite"),
    ],
)
def test_a_failure_is_internal_and_logged_under_its_id(
    service: Any,
    engine: Any,
    fields: dict[str, Any],
    caplog: pytest.LogCaptureFixture,
    fault: Callable[[AnchorBatch], AnchorBatch],
    logged: str,
) -> None:
    engine.before_answer = fault
    answer = service.post(fields | {"request_id": "r7"})
    engine.before_answer = lambda batch: batch

    error = refusal(answer, 500, "internal")
    assert error["field"] is None
    assert "r7" in error["message"]
    assert "Traceback" not in answer.text
    assert logged not in answer.text
    assert "request r7 failed" in caplog.text
    assert logged in caplog.text
