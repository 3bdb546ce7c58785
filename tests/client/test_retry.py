"""The retrying clients over a service whose failures and clock the test controls."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from staged_planner import ANSWER

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


class Stage:
    """A transport that fails a number of times, and the clock, which attempts advance."""

    def __init__(self, error: AnchorFlowError, failures: int = 1, takes_s: float = 0.0) -> None:
        self.now = 100.0
        self.slept: list[float] = []
        self.sent: list[dict[str, Any]] = []
        self.closed = False
        self._error = error
        self._failures = failures
        self._takes_s = takes_s

    def send(self, *sent: Any, **_: Any) -> HttpAnswer:
        method, path, headers, body, timeout_s = sent
        assert (method, path) == (("GET", "/v2/models") if body is None else ("POST", "/anchors"))
        assert (headers["Accept"], timeout_s) == ("application/json", 30.0)
        self.sent.append(json.loads(body or b"{}"))
        self.now += self._takes_s
        if len(self.sent) > self._failures:
            return 200, {}, json.dumps({"models": []} if body is None else ANSWER).encode()
        if not isinstance(self._error, RequestError):
            raise self._error
        retry_after_s = getattr(self._error, "retry_after_s", None)
        retry = {} if retry_after_s is None else {"retry-after": str(retry_after_s)}
        return self._error.http_status, retry, json.dumps(self._error.to_dict()).encode()

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
    """Makes the blocking or the async retrying client over a stage, with its clock."""

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
def test_a_transient_error_is_retried(
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
def test_another_error_is_raised_at_once(
    retrying: Retrying, kind: type[AnchorFlowError], fields: dict[str, Any]
) -> None:
    stage = Stage(kind("no"))

    with pytest.raises(kind, match="no"):
        retrying(stage).plan(**fields)
    assert (len(stage.sent), stage.slept) == (1, [])


@pytest.mark.parametrize("draw", [0.0, 0.5, 1.0])
def test_pauses_double_up_to_the_longest_and_are_drawn_from_their_upper_half(
    retrying: Retrying, draw: float, fields: dict[str, Any]
) -> None:
    stage = Stage(NotReady("a moment"), failures=6)

    retrying(stage, draw=draw, first_pause_s=0.1, longest_pause_s=1.0).plan(**fields)

    pauses = np.array([0.1, 0.2, 0.4, 0.8, 1.0, 1.0])
    assert stage.slept == pytest.approx(pauses * (0.5 + 0.5 * draw))


def test_times_of_numpy_are_slept_as_numbers(retrying: Retrying, fields: dict[str, Any]) -> None:
    stage = Stage(NotReady("a moment"), failures=1)
    tenth = np.float32(0.1)

    retrying(stage, first_pause_s=tenth, longest_pause_s=tenth, patience_s=tenth * 9).plan(**fields)

    assert [type(seconds) for seconds in stage.slept] == [float]


def test_patience_may_be_endless(retrying: Retrying, fields: dict[str, Any]) -> None:
    """2,000 doublings of a pause are more than a float holds."""
    stage = Stage(NotReady("a moment"), failures=2000)

    assert retrying(stage, patience_s=float("inf")).plan(**fields).seed == 3
    assert all(each.get("budget_ms") is None for each in stage.sent)


def test_an_overloaded_service_sets_the_pause(retrying: Retrying, fields: dict[str, Any]) -> None:
    stage = Stage(Overloaded("full", retry_after_s=3), failures=2)
    retrying(stage).plan(**fields)
    assert stage.slept == [3, 3]

    stage = Stage(Overloaded("full", retry_after_s=7))
    with pytest.raises(Overloaded, match="full") as caught:
        retrying(stage, patience_s=5.0).plan(**fields)
    assert caught.value.retry_after_s == 7
    assert stage.slept == []  # the pause would exceed the patience


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


def test_nothing_is_sent_beyond_the_budget(retrying: Retrying, fields: dict[str, Any]) -> None:
    stage = Stage(NotReady("a moment"), failures=1000, takes_s=0.05)

    with pytest.raises(NotReady):
        retrying(stage, patience_s=60.0).plan(**fields, budget_ms=500)
    assert [each["budget_ms"] for each in stage.sent] == pytest.approx([500, 350, 100])
    assert stage.now - 100.0 <= 0.5


def test_a_pause_that_takes_too_long_ends_the_attempts(
    retrying: Retrying, fields: dict[str, Any]
) -> None:
    stage = Stage(NotReady("a moment"), failures=1)

    def oversleep(seconds: float) -> None:
        stage.sleep(seconds + 10.0)

    with pytest.raises(NotReady):
        retrying(stage, sleep=oversleep).plan(**fields, budget_ms=500)
    assert len(stage.sent) == 1


def test_models_is_retried_and_health_is_not(retrying: Retrying) -> None:
    stage = Stage(ConnectionFailed("nobody listens"))
    with retrying(stage) as client:
        assert client.models() == ()
        assert len(stage.sent) == 2
        assert not stage.closed
    assert stage.closed

    class Health(Stage):
        def send(self, *_: Any, **__: Any) -> HttpAnswer:
            self.sent.append({})
            raise ConnectionFailed("nobody listens")

    down = Health(ConnectionFailed(""))
    assert not retrying(down).ready()
    assert not retrying(down).live()
    assert len(down.sent) == 2


@pytest.mark.parametrize("name", ["patience_s", "first_pause_s", "longest_pause_s"])
@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan")])
def test_a_time_not_above_zero_is_refused(retrying: Retrying, name: str, seconds: float) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected a number above 0"):
        retrying(Stage(NotReady("")), **{name: seconds})
