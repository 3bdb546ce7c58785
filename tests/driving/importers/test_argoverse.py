"""What Argoverse 2 alone has: tracks as rows in any order, boxes by type, bicycle lanes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_argoverse import FRAMES, NAME, SPEED, recording, write

pytest.importorskip("pyarrow", reason="pyarrow reads parquet: pip install pyarrow")

from anchorflow_driving.importers.argoverse import import_argoverse


@pytest.fixture
def made() -> dict[str, Any]:
    return recording()


def test_tracks_and_lanes_are_those_of_the_files(tmp_path: Path, made: dict[str, Any]) -> None:
    log, counts = import_argoverse(write(tmp_path, made) / f"scenario_{NAME}.parquet")

    t = np.arange(FRAMES) * 0.1
    np.testing.assert_allclose(log.track_state[0, :, 0], SPEED * t, atol=1e-4)
    np.testing.assert_allclose(log.track_state[1, :, 0], 30 + SPEED * t, atol=1e-4)
    assert np.flatnonzero(np.isfinite(log.track_state[2, :, 0])).tolist() == list(range(40, 60))
    assert sorted(log.line_solid.tolist()) == [False, False, False, False, True]
    np.testing.assert_allclose(log.polylines("centre")[2][:, 1], 4.0, atol=1e-4)
    np.testing.assert_allclose(np.ptp(log.polylines("crosswalk")[0], axis=0), [4.0, 8.0])
    assert counts["windows"] == 2 * 5


def test_the_order_of_rows_does_not_matter(tmp_path: Path, made: dict[str, Any]) -> None:
    log, _ = import_argoverse(write(tmp_path, made))
    made["states"].reverse()
    other, _ = import_argoverse(write(tmp_path, made))

    np.testing.assert_array_equal(other.track_state, log.track_state)
