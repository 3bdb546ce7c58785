"""A request can be cancelled before and while a thread waits for it."""

from __future__ import annotations

from anchorflow_client import Cancellation


def test_callbacks_run_at_and_after_the_cancellation() -> None:
    cancellation, called = Cancellation(), []

    with cancellation.watched_by(lambda: called.append("inside")):
        assert not cancellation.is_cancelled
        cancellation.cancel()
        assert called == ["inside"]
    with cancellation.watched_by(lambda: called.append("later")):
        assert called == ["inside", "later"]
    cancellation.cancel()

    assert cancellation.is_cancelled
    assert called == ["inside", "later"]
