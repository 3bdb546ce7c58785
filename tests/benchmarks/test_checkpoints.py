"""What `anchorflow bench checkpoints` compares, and the commands that it runs."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.checkpoints import distances, run


def test_a_trajectory_is_compared_with_the_nearest_by_its_farthest_pose() -> None:
    line = np.zeros((8, 3), np.float32)
    line[:, 0] = np.arange(8)
    wanted = np.stack([line, np.add(line, (0.0, 5.0, 0.0))])
    got = wanted[::-1].copy()
    got[0, -1, 1] += 0.25
    got[0, 3, 1] -= 0.125
    got[..., 2] += 9.0  # headings are no distance
    np.testing.assert_allclose(distances([got], [wanted]), [0.25, 0.0])


def test_a_command_that_fails_is_named_with_its_error() -> None:
    with pytest.raises(BenchmarkError, match=r"anchorflow checkpoint nowhere .*--out.*: .*nowhere"):
        run("checkpoint", "nowhere", "--out", "nowhere.pt")
