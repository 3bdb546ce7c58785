"""Fields of maps are computed once within a memory bound; cached attributes need no lock."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import pytest

from anchorflow_trajectory.caching import MapCache, cached_property
from anchorflow_trajectory.cost import clearance
from anchorflow_trajectory.cost.clearance import clearance_field, signed_distance

FREE = np.zeros((8, 8), bool)
ENTRY = 8 + 8 * 8 * 4  # bytes of key and field


class Counted:
    """Works out a field, and counts how often."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, occupied: np.ndarray, resolution: float) -> np.ndarray:
        self.calls += 1
        return (occupied * resolution).astype(np.float32)


def with_cell(place: int) -> np.ndarray:
    occupied = FREE.copy()
    occupied.flat[place] = True
    return occupied


def test_the_same_map_is_worked_out_once() -> None:
    cache, work_out = MapCache(most_bytes=1 << 20), Counted()
    field = cache.of(with_cell(3), 0.5, work_out)

    assert cache.of(with_cell(3), 0.5, work_out) is field
    assert work_out.calls == 1
    assert field.flat[3] == 0.5
    with pytest.raises(ValueError, match="read-only"):
        field[0, 0] = 1.0


@pytest.mark.parametrize(
    ("occupied", "resolution"),
    [(with_cell(4), 0.5), (with_cell(3), 0.25), (with_cell(3).reshape(4, 16), 0.5)],
    ids=["another cell", "another resolution", "another shape"],
)
def test_another_map_is_worked_out_anew(occupied: np.ndarray, resolution: float) -> None:
    cache, work_out = MapCache(most_bytes=1 << 20), Counted()
    cache.of(with_cell(3), 0.5, work_out)

    np.testing.assert_array_equal(
        cache.of(occupied, resolution, work_out), occupied * np.float32(resolution)
    )
    assert work_out.calls == 2


def test_what_was_not_asked_for_longest_goes_first() -> None:
    cache, work_out = MapCache(most_bytes=2 * ENTRY), Counted()
    for place in (0, 1, 0, 2, 0):
        cache.of(with_cell(place), 0.5, work_out)
    assert (work_out.calls, len(cache)) == (3, 2)
    cache.of(with_cell(1), 0.5, work_out)
    assert work_out.calls == 4


def test_a_map_that_is_too_large_is_answered_and_not_kept() -> None:
    cache, work_out = MapCache(most_bytes=ENTRY - 1), Counted()
    assert cache.of(with_cell(0), 0.5, work_out).shape == (8, 8)
    assert len(cache) == 0


def test_threads_share_it() -> None:
    cache, work_out = MapCache(most_bytes=4 * ENTRY), Counted()
    places = np.random.default_rng(0).integers(0, 12, 4000).tolist()
    with ThreadPoolExecutor(4) as pool:
        fields = list(pool.map(lambda k: cache.of(with_cell(k), 0.5, work_out), places))

    assert all(field.flat[k] == 0.5 for field, k in zip(fields, places, strict=True))
    for place in range(12, 20):  # the cache keeps as many as it has room for
        cache.of(with_cell(place), 0.5, work_out)
        assert len(cache) == 4


def test_robots_of_all_sizes_share_a_map(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def counted(occupied: np.ndarray, resolution: float) -> np.ndarray:
        calls.append(resolution)
        return signed_distance(occupied, resolution)

    monkeypatch.setattr(clearance, "SHARED", MapCache(most_bytes=1 << 20))
    monkeypatch.setattr(clearance, "signed_distance", counted)
    small, large = (clearance_field(with_cell(27), 1.0, radius) for radius in (0.25, 0.5))

    assert calls == [1.0]
    assert small[3, 3] - large[3, 3] == pytest.approx(0.25)


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
