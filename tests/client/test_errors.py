"""The error tree on the wire."""

from __future__ import annotations

from typing import Any

import pytest

from anchorflow_client import errors
from anchorflow_client.errors import InvalidAnswer, InvalidRequest, Overloaded, RequestError

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


def test_overloaded_says_when_to_come_back() -> None:
    came = RequestError.from_dict(Overloaded("full").to_dict(), retry_after_s=3.0)

    assert isinstance(came, Overloaded)
    assert came.retry_after_s == 3.0


def test_overloaded_says_so_itself_where_there_is_no_header() -> None:
    came = RequestError.from_dict(Overloaded("full", retry_after_s=3).to_dict())

    assert isinstance(came, Overloaded)
    assert came.retry_after_s == 3


@pytest.mark.parametrize("told", [None, "3", True, -1, float("nan"), float("inf"), 10**400])
def test_a_time_to_come_back_that_is_none_is_not_believed(told: Any) -> None:
    error = {"code": "overloaded", "message": "full", "field": None, "retry_after_s": told}

    came = RequestError.from_dict({"error": error})

    assert isinstance(came, Overloaded)
    assert came.retry_after_s is None


def test_a_later_services_code_is_kept() -> None:
    answer = {"error": {"code": "too_cold", "message": "warm up", "field": None}}

    came = RequestError.from_dict(answer, http_status=418)

    assert (came.code, came.http_status) == ("too_cold", 418)


@pytest.mark.parametrize("answer", [[], {}, {"error": "no"}, {"error": {"code": 1, "message": ""}}])
def test_what_is_not_the_contracts_is_an_invalid_answer(answer: Any) -> None:
    with pytest.raises(InvalidAnswer):
        RequestError.from_dict(answer)
