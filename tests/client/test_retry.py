"""The retrying client over a service that fails as the test says, at the test's own time."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import pytest

from anchorflow_client import (
    AnchorClient,
    AnchorFlowError,
    ConnectionFailed,
    DeadlineExceeded,
    InternalError,
    InvalidAnswer,
    InvalidRequest,
    JsonCodec,
    NotReady,
    Overloaded,
    RequestError,
    RetryingClient,
    Superseded,
    TimedOut,
    TooLarge,
    Unauthorized,
    UnknownModel,
)
from anchorflow_client.transport import HttpAnswer

ANSWER = {
    "trajectories": [[[0.0, 0.0], [1.0, 0.0]]],
    "velocities": [[[0.0, 0.0], [0.0, 0.0]]],
    "accelerations": [[[0.0, 0.0], [0.0, 0.0]]],
    "scores": [1.0],
    "clearance": [0.5],
    "safe": [True],
    "dt": 1.0,
    "seed": 3,
    "model": {"name": "lines", "version": "1", "sha256": "ab"},
    "timing_ms": {"total": 1.0},
    "request_id": "r1",
}


class Stage:
    """A transport that fails so many times in one way, and the clock, which an attempt moves on."""

    def __init__(self, error: AnchorFlowError, failures: int = 1, takes_s: float = 0.0) -> None:
        self.now = 100.0
        self.slept: list[float] = []
        self.sent: list[dict[str, Any]] = []
        self.closed = False
        self._error = error
        self._failures = failures
        self._takes_s = takes_s

    def client(self, *, draw: float = 1.0, **options: Any) -> RetryingClient:
        return RetryingClient(
            AnchorClient("http://robot", transport=self, codec=JsonCodec()),
            clock=lambda: self.now,
            sleep=self._sleep,
            draw=lambda: draw,
            **options,
        )

    def send(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        body: bytes | None,
        timeout_s: float,
    ) -> HttpAnswer:
        assert (method, path) == (("GET", "/v2/models") if body is None else ("POST", "/anchors"))
        assert (headers["Accept"], timeout_s) == ("application/json", 30.0)
        self.sent.append(json.loads(body or b"{}"))
        self.now += self._takes_s
        if len(self.sent) > self._failures:
            return 200, {}, json.dumps({"models": []} if body is None else ANSWER).encode()
        if not isinstance(self._error, RequestError):
            raise self._error
        retry_after_s = getattr(self._error, "retry_after_s", None)
        told = {} if retry_after_s is None else {"retry-after": str(retry_after_s)}
        return self._error.http_status, told, json.dumps(self._error.to_dict()).encode()

    def close(self) -> None:
        self.closed = True

    def _sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


@pytest.mark.parametrize("kind", [Overloaded, NotReady, ConnectionFailed, TimedOut])
def test_what_passes_is_asked_again(kind: type[AnchorFlowError], fields: dict[str, Any]) -> None:
    stage = Stage(kind("a moment"), failures=3)

    assert stage.client().plan(**fields).seed == 3
    assert len(stage.sent) == 4


@pytest.mark.parametrize(
    "kind",
    [
        DeadlineExceeded,
        InternalError,
        InvalidAnswer,
        InvalidRequest,
        Superseded,
        TooLarge,
        Unauthorized,
        UnknownModel,
    ],
)
def test_what_does_not_pass_is_raised_at_once(
    kind: type[AnchorFlowError], fields: dict[str, Any]
) -> None:
    stage = Stage(kind("no"))

    with pytest.raises(kind, match="no"):
        stage.client().plan(**fields)
    assert (len(stage.sent), stage.slept) == (1, [])


def test_a_proxys_words_are_asked_again(fields: dict[str, Any]) -> None:
    class Proxy(Stage):
        def send(self, *told: Any, **_: Any) -> HttpAnswer:
            super().send(*told)
            return (502, {}, b"<html>") if len(self.sent) == 1 else (200, {}, _answer())

    stage = Proxy(NotReady(""), failures=0)

    assert stage.client().plan(**fields).seed == 3
    assert len(stage.sent) == 2


def _answer() -> bytes:
    return json.dumps(ANSWER).encode()


def test_pauses_double_up_to_the_longest(fields: dict[str, Any]) -> None:
    stage = Stage(NotReady("a moment"), failures=6)

    stage.client(first_pause_s=0.1, longest_pause_s=1.0).plan(**fields)

    assert stage.slept == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.0, 1.0])


@pytest.mark.parametrize("draw", [0.0, 0.5, 1.0])
def test_a_pause_is_from_half_its_length_to_all_of_it(draw: float, fields: dict[str, Any]) -> None:
    stage = Stage(NotReady("a moment"), failures=2)

    stage.client(draw=draw).plan(**fields)

    assert stage.slept == pytest.approx([0.1 * (0.5 + 0.5 * draw), 0.2 * (0.5 + 0.5 * draw)])


def test_patience_may_be_endless(fields: dict[str, Any]) -> None:
    """2,000 doublings of a pause are more than a float holds."""
    stage = Stage(NotReady("a moment"), failures=2000)

    assert stage.client(patience_s=float("inf")).plan(**fields).seed == 3


def test_an_overloaded_service_says_how_long_to_wait(fields: dict[str, Any]) -> None:
    stage = Stage(Overloaded("full", retry_after_s=3), failures=2)

    stage.client().plan(**fields)

    assert stage.slept == [3, 3]


def test_it_does_not_wait_for_a_place_beyond_its_patience(fields: dict[str, Any]) -> None:
    stage = Stage(Overloaded("full", retry_after_s=7))

    with pytest.raises(Overloaded, match="full") as caught:
        stage.client(patience_s=5.0).plan(**fields)
    assert caught.value.retry_after_s == 7
    assert stage.slept == []


def test_patience_ends_with_the_last_error(fields: dict[str, Any]) -> None:
    stage = Stage(ConnectionFailed("nobody listens"), failures=1000, takes_s=0.5)

    with pytest.raises(ConnectionFailed, match="nobody listens"):
        stage.client(patience_s=4.0).plan(**fields)
    assert stage.now - 100.0 <= 4.0 + 0.5
    assert len(stage.sent) == 5  # at 0, 0.6, 1.3, 2.2 and 3.5 s; the next would be at 5.6


def test_the_budget_that_is_sent_shrinks_by_what_has_passed(fields: dict[str, Any]) -> None:
    stage = Stage(NotReady("a moment"), failures=2, takes_s=0.05)

    stage.client().plan(**fields, budget_ms=1000)

    # An attempt takes 50 ms, the pauses are 100 and 200 ms.
    assert [each["budget_ms"] for each in stage.sent] == pytest.approx([1000, 850, 600])


def test_nothing_is_asked_beyond_the_budget(fields: dict[str, Any]) -> None:
    stage = Stage(NotReady("a moment"), failures=1000, takes_s=0.05)

    with pytest.raises(NotReady):
        stage.client(patience_s=60.0).plan(**fields, budget_ms=500)
    assert [each["budget_ms"] for each in stage.sent] == pytest.approx([500, 350, 100])
    assert stage.now - 100.0 <= 0.5


def test_who_sleeps_too_long_does_not_ask_with_a_spent_budget(fields: dict[str, Any]) -> None:
    stage = Stage(NotReady("a moment"), failures=1)
    client = RetryingClient(
        AnchorClient("http://robot", transport=stage, codec=JsonCodec()),
        clock=lambda: stage.now,
        sleep=lambda seconds: setattr(stage, "now", stage.now + seconds + 10.0),
    )

    with pytest.raises(NotReady):
        client.plan(**fields, budget_ms=500)
    assert len(stage.sent) == 1


def test_a_request_without_a_budget_gets_none(fields: dict[str, Any]) -> None:
    stage = Stage(NotReady("a moment"), failures=2)

    stage.client().plan(**fields)

    assert all(each.get("budget_ms") is None for each in stage.sent)


def test_cards_are_asked_for_again_and_health_is_not() -> None:
    stage = Stage(ConnectionFailed("nobody listens"))
    assert stage.client().models() == ()
    assert len(stage.sent) == 2

    class Health(Stage):
        def send(self, *_: Any, **__: Any) -> HttpAnswer:
            self.sent.append({})
            raise ConnectionFailed("nobody listens")

    down = Health(ConnectionFailed(""))
    assert not down.client().ready()
    assert not down.client().live()
    assert len(down.sent) == 2


def test_leaving_the_block_closes_the_client_beneath() -> None:
    stage = Stage(NotReady(""))

    with stage.client():
        assert not stage.closed
    assert stage.closed


@pytest.mark.parametrize("name", ["patience_s", "first_pause_s", "longest_pause_s"])
@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan")])
def test_a_time_that_is_none_is_refused(name: str, seconds: float) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected a number above 0"):
        Stage(NotReady("")).client(**{name: seconds})
