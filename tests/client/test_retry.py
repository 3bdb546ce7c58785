"""The retrying clients over a service that fails as the test says, at the test's own time."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from anchorflow_client import (
    AnchorClient,
    AnchorFlowError,
    AsyncAnchorClient,
    AsyncRetryingClient,
    AsyncTransport,
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
    Transport,
    Unauthorized,
    UnknownModel,
)
from anchorflow_client.http.transport import HttpAnswer

Retrying = Callable[..., Any]
Sleep = Callable[[float], None]

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

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


@pytest.fixture(params=["blocking", "async"])
def retrying(
    request: pytest.FixtureRequest,
    blocking: Callable[[Any], Any],
    async_twin: Callable[[Transport], AsyncTransport],
) -> Retrying:
    """Makes the retrying client over a stage, at its time, and another time the async one."""

    def make(stage: Stage, *, draw: float = 1.0, sleep: Sleep | None = None, **options: Any) -> Any:
        slept = sleep or stage.sleep
        options |= {"clock": lambda: stage.now, "draw": lambda: draw}
        if request.param == "blocking":
            beneath = AnchorClient("http://robot", transport=stage, codec=JsonCodec())
            return RetryingClient(beneath, sleep=slept, **options)

        async def sleeping(seconds: float) -> None:
            slept(seconds)

        beneath = AsyncAnchorClient("http://robot", transport=async_twin(stage), codec=JsonCodec())
        return blocking(AsyncRetryingClient(beneath, sleep=sleeping, **options))

    return make


@pytest.mark.parametrize("kind", [Overloaded, NotReady, ConnectionFailed, TimedOut])
def test_what_passes_is_asked_again(
    retrying: Retrying, kind: type[AnchorFlowError], fields: dict[str, Any]
) -> None:
    stage = Stage(kind("a moment"), failures=3)

    assert retrying(stage).plan(**fields).seed == 3
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
    retrying: Retrying, kind: type[AnchorFlowError], fields: dict[str, Any]
) -> None:
    stage = Stage(kind("no"))

    with pytest.raises(kind, match="no"):
        retrying(stage).plan(**fields)
    assert (len(stage.sent), stage.slept) == (1, [])


def test_a_proxys_words_are_asked_again(retrying: Retrying, fields: dict[str, Any]) -> None:
    class Proxy(Stage):
        def send(self, *told: Any, **_: Any) -> HttpAnswer:
            super().send(*told)
            return (502, {}, b"<html>") if len(self.sent) == 1 else (200, {}, _answer())

    stage = Proxy(NotReady(""), failures=0)

    assert retrying(stage).plan(**fields).seed == 3
    assert len(stage.sent) == 2


def _answer() -> bytes:
    return json.dumps(ANSWER).encode()


def test_pauses_double_up_to_the_longest(retrying: Retrying, fields: dict[str, Any]) -> None:
    stage = Stage(NotReady("a moment"), failures=6)

    retrying(stage, first_pause_s=0.1, longest_pause_s=1.0).plan(**fields)

    assert stage.slept == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.0, 1.0])


@pytest.mark.parametrize("draw", [0.0, 0.5, 1.0])
def test_a_pause_is_from_half_its_length_to_all_of_it(
    retrying: Retrying, draw: float, fields: dict[str, Any]
) -> None:
    stage = Stage(NotReady("a moment"), failures=2)

    retrying(stage, draw=draw).plan(**fields)

    assert stage.slept == pytest.approx([0.1 * (0.5 + 0.5 * draw), 0.2 * (0.5 + 0.5 * draw)])


def test_times_of_numpy_are_slept_as_numbers(retrying: Retrying, fields: dict[str, Any]) -> None:
    stage = Stage(NotReady("a moment"), failures=1)
    tenth = np.float32(0.1)

    retrying(stage, first_pause_s=tenth, longest_pause_s=tenth, patience_s=tenth * 9).plan(**fields)

    assert [type(seconds) for seconds in stage.slept] == [float]


def test_patience_may_be_endless(retrying: Retrying, fields: dict[str, Any]) -> None:
    """2,000 doublings of a pause are more than a float holds."""
    stage = Stage(NotReady("a moment"), failures=2000)

    assert retrying(stage, patience_s=float("inf")).plan(**fields).seed == 3


def test_an_overloaded_service_says_how_long_to_wait(
    retrying: Retrying, fields: dict[str, Any]
) -> None:
    stage = Stage(Overloaded("full", retry_after_s=3), failures=2)

    retrying(stage).plan(**fields)

    assert stage.slept == [3, 3]


def test_it_does_not_wait_for_a_place_beyond_its_patience(
    retrying: Retrying, fields: dict[str, Any]
) -> None:
    stage = Stage(Overloaded("full", retry_after_s=7))

    with pytest.raises(Overloaded, match="full") as caught:
        retrying(stage, patience_s=5.0).plan(**fields)
    assert caught.value.retry_after_s == 7
    assert stage.slept == []


def test_patience_ends_with_the_last_error(retrying: Retrying, fields: dict[str, Any]) -> None:
    stage = Stage(ConnectionFailed("nobody listens"), failures=1000, takes_s=0.5)

    with pytest.raises(ConnectionFailed, match="nobody listens"):
        retrying(stage, patience_s=4.0).plan(**fields)
    assert stage.now - 100.0 <= 4.0 + 0.5
    assert len(stage.sent) == 5  # at 0, 0.6, 1.3, 2.2 and 3.5 s; the next would be at 5.6


def test_the_budget_that_is_sent_shrinks_by_what_has_passed(
    retrying: Retrying, fields: dict[str, Any]
) -> None:
    stage = Stage(NotReady("a moment"), failures=2, takes_s=0.05)

    retrying(stage).plan(**fields, budget_ms=1000)

    # An attempt takes 50 ms, the pauses are 100 and 200 ms.
    assert [each["budget_ms"] for each in stage.sent] == pytest.approx([1000, 850, 600])


def test_nothing_is_asked_beyond_the_budget(retrying: Retrying, fields: dict[str, Any]) -> None:
    stage = Stage(NotReady("a moment"), failures=1000, takes_s=0.05)

    with pytest.raises(NotReady):
        retrying(stage, patience_s=60.0).plan(**fields, budget_ms=500)
    assert [each["budget_ms"] for each in stage.sent] == pytest.approx([500, 350, 100])
    assert stage.now - 100.0 <= 0.5


def test_who_sleeps_too_long_does_not_ask_with_a_spent_budget(
    retrying: Retrying, fields: dict[str, Any]
) -> None:
    stage = Stage(NotReady("a moment"), failures=1)

    def oversleep(seconds: float) -> None:
        stage.sleep(seconds + 10.0)

    with pytest.raises(NotReady):
        retrying(stage, sleep=oversleep).plan(**fields, budget_ms=500)
    assert len(stage.sent) == 1


def test_a_request_without_a_budget_gets_none(retrying: Retrying, fields: dict[str, Any]) -> None:
    stage = Stage(NotReady("a moment"), failures=2)

    retrying(stage).plan(**fields)

    assert all(each.get("budget_ms") is None for each in stage.sent)


def test_cards_are_asked_for_again_and_health_is_not(retrying: Retrying) -> None:
    stage = Stage(ConnectionFailed("nobody listens"))
    assert retrying(stage).models() == ()
    assert len(stage.sent) == 2

    class Health(Stage):
        def send(self, *_: Any, **__: Any) -> HttpAnswer:
            self.sent.append({})
            raise ConnectionFailed("nobody listens")

    down = Health(ConnectionFailed(""))
    assert not retrying(down).ready()
    assert not retrying(down).live()
    assert len(down.sent) == 2


def test_leaving_the_block_closes_the_client_beneath(retrying: Retrying) -> None:
    stage = Stage(NotReady(""))

    with retrying(stage):
        assert not stage.closed
    assert stage.closed


@pytest.mark.parametrize("name", ["patience_s", "first_pause_s", "longest_pause_s"])
@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan")])
def test_a_time_that_is_none_is_refused(retrying: Retrying, name: str, seconds: float) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected a number above 0"):
        retrying(Stage(NotReady("")), **{name: seconds})
