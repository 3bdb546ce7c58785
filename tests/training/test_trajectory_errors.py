"""Trajectory files that are refused: the error names the file, the array and its shape."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trajectory_files import COUNT, RNG, STEPS, l2_arrays, saved

from anchorflow_training.data import DatasetError, TrajectoryDataset


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"positions": np.zeros((4, 9))}, r"positions: expected \[N, T, D\].*found \[4, 9\]"),
        ({"positions": np.zeros((4, 2, 2))}, r"positions: .*T >= 3.*found \[4, 2, 2\]"),
        ({"positions": np.zeros((4, 9, 4))}, r"positions: .*D 2 or 3.*found \[4, 9, 4\]"),
        (
            {"velocities": np.zeros((COUNT, STEPS - 1, 2))},
            r"velocities: expected \[12, 9, 2\] beside positions \[12, 9, 2\], found \[12, 8, 2\]",
        ),
        (
            {"goal_states": np.zeros((COUNT, 6))},
            r"goal_states: expected \[12, 4\].*found \[12, 6\]",
        ),
        ({"quality": np.zeros((COUNT, 1))}, r"quality: expected \[12\].*found \[12, 1\]"),
        ({"origin": np.zeros(3)}, r"origin: expected \[2\] or \[12, 2\].*found \[3\]"),
        ({"cost_maps": np.zeros((COUNT, 16, 16))}, r"cost_maps: expected \[12, C, H, W\]"),
        (
            {"cost_maps": np.zeros((COUNT, 1, 8, 16))},
            r"cost_maps: .*H and W 16\.\.512, found \[12, 1, 8, 16\]",
        ),
        ({"cost_maps": np.full((COUNT, 1, 16, 16), 100.0)}, r"cost_maps: .*\[0, 1\].*row 0"),
        (
            {"cost_maps": np.eye(16, dtype=np.uint8)[None, None].repeat(COUNT, 0)},
            r"cost_maps: expected 255 for 1 in 8 bits, found at most 1",
        ),
        (
            {"cost_maps": np.full((COUNT, 1, 16, 16), 100, np.uint8)},
            r"cost_maps: expected 255 for 1 in 8 bits, found at most 100",
        ),
        ({"style_weights": np.zeros((COUNT, 3))}, r"style_weights: .*not all 0.*row 0"),
        ({"quality": np.arange(COUNT) / 5}, r"quality: .*in \[0, 1\], found 1\.2.*row 6"),
        ({"safety_margins": -np.ones(COUNT)}, r"safety_margins: expected values at least 0"),
        ({"resolution": 0.0}, r"resolution: expected values more than 0"),
        ({"dt": -1.0}, r"dt: expected seconds above 0, found -1"),
        (
            {"horizon_s": 5.0},
            r"expected one time step.* found 0\.1 s from dt, 0\.625 s from horizon_s",
        ),
        ({"positions": np.full((COUNT, STEPS, 2), np.nan)}, r"expected a row of finite numbers"),
        (
            {"positions": np.zeros((COUNT, STEPS, 2), "U3")},
            r"positions: expected numbers, found <U3",
        ),
    ],
)
def test_errors_name_file_array_and_shapes(
    changed: dict[str, Any], said: str, tmp_path: Path
) -> None:
    with pytest.raises(DatasetError, match=r"wrong\.npz: " + said):
        TrajectoryDataset(saved(tmp_path / "wrong.npz", **l2_arrays(**changed)))


def test_no_positions_lists_what_there_is(tmp_path: Path) -> None:
    np.savez(tmp_path / "p.npz", RNG.normal(size=(3, 4, 2)))
    with pytest.raises(DatasetError, match=r"positions: expected .* found only arr_0"):
        TrajectoryDataset(tmp_path / "p.npz")
