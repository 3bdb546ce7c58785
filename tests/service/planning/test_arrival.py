"""The caller's time."""

from __future__ import annotations

import pytest

from anchorflow_client import DeadlineExceeded
from anchorflow_service.planning import Arrival


def test_a_budget_counts_from_arrival() -> None:
    now = [100.0]
    arrival = Arrival(clock=lambda: now[0])
    now[0] = 100.05

    assert arrival.elapsed_ms == pytest.approx(50)
    arrival.check(60, "in the queue")
    arrival.check(None, "in the queue")
    with pytest.raises(DeadlineExceeded, match=r"within 40 ms, 50\.0 ms had passed in the queue"):
        arrival.check(40, "in the queue")
