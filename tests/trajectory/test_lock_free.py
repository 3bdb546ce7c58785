"""Threads that work out the same attribute of different objects do not wait for each other."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from anchorflow_trajectory.caching import cached_property


@dataclass(frozen=True, eq=False)
class Field:
    barrier: threading.Barrier

    @cached_property
    def met(self) -> object:
        """Met."""
        self.barrier.wait(timeout=10)
        return object()


def test_attributes_of_two_objects_are_worked_out_at_a_time() -> None:
    """Each thread waits until the other computes too; the second access does not wait."""
    barrier = threading.Barrier(2)
    fields = [Field(barrier), Field(barrier)]
    with ThreadPoolExecutor(2) as pool:
        first = list(pool.map(lambda field: field.met, fields))
    assert first[0] is not first[1]
    assert [field.met for field in fields] == first
    assert Field.met.__doc__ == "Met."
