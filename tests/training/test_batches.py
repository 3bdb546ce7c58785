"""Batches are prepared ahead and keep their order."""

from __future__ import annotations

import threading
from itertools import islice

import numpy as np
import pytest

from anchorflow_training.batches import Batch, prefetched


@pytest.mark.parametrize("threads", [1, 3])
def test_batches_come_in_order_whichever_is_ready_first(threads: int) -> None:
    asked: list[int] = []
    last_is_ready = threading.Event()

    def draw(index: int) -> Batch:
        asked.append(index)
        if index == threads - 1:  # earlier batches wait for this one
            last_is_ready.set()
        assert last_is_ready.wait(timeout=30)
        return {"number": np.array(index)}

    batches = prefetched(draw, range(20), threads=threads)
    assert [int(batch["number"]) for batch in islice(batches, 4)] == [0, 1, 2, 3]
    # No more are drawn than those taken and `threads` ahead.
    assert max(asked) <= 4 + threads
    batches.close()
    assert max(asked) <= 4 + threads
    whole = prefetched(draw, range(3), threads=threads)
    assert [int(batch["number"]) for batch in whole] == [0, 1, 2]


def test_what_goes_wrong_in_a_batch_is_raised_in_its_place() -> None:
    def draw(index: int) -> Batch:
        if index == 2:
            raise ValueError("this one")
        return {}

    batches = prefetched(draw, range(5), threads=2)
    assert len([*islice(batches, 2)]) == 2
    with pytest.raises(ValueError, match="this one"):
        next(batches)
