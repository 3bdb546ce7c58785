"""A request can be taken back before and while somebody waits for it."""

from __future__ import annotations

from anchorflow_client import Cancellation


def test_who_watches_is_told() -> None:
    cancellation, told = Cancellation(), []

    with cancellation.watched_by(lambda: told.append("inside")):
        assert not cancellation.is_cancelled
        cancellation.cancel()
        assert told == ["inside"]
    with cancellation.watched_by(lambda: told.append("later")):
        assert told == ["inside", "later"]
    cancellation.cancel()

    assert cancellation.is_cancelled
    assert told == ["inside", "later"]
