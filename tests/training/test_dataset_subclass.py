"""A subclass of the trajectory dataset that changes its samples."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from trajectory_files import COUNT, l2_arrays, saved

from anchorflow_training.data import DatasetError, TrajectoryDataset, create_dataloader


class Doubled(TrajectoryDataset):
    """Every trajectory at twice its size, by an attribute that the base class cannot know."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.scale = 2.0

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        sample = super().__getitem__(index)
        names = "positions", "velocities", "accelerations"
        return sample | {name: self.scale * sample[name] for name in names}


class DoubledBatches(Doubled):
    """The same by batches, as torch documents `__getitems__`: a list of samples."""

    def __getitems__(self, indices: Sequence[int]) -> Any:
        return [self[index] for index in indices]


@pytest.mark.parametrize("kind", [Doubled, DoubledBatches])
def test_a_subclass_is_what_batches_and_statistics_are_made_of(
    kind: type[Doubled], tmp_path: Path
) -> None:
    path = saved(tmp_path / "p.npz", **l2_arrays())
    plain, doubled = TrajectoryDataset(path), kind(path)
    theirs, ours = (
        next(iter(create_dataloader(each, COUNT, shuffle=False))) for each in (plain, doubled)
    )
    torch.testing.assert_close(ours["velocities"], 2 * theirs["velocities"])
    torch.testing.assert_close(ours["quality"], theirs["quality"])
    np.testing.assert_allclose(
        doubled.statistics.positions.std, 2 * np.array(plain.statistics.positions.std), rtol=1e-5
    )
    np.testing.assert_allclose(doubled.peak_speed, 2 * plain.peak_speed, rtol=1e-5)
    normalised = next(iter(create_dataloader(doubled, COUNT, normalise=True)))
    torch.testing.assert_close(
        normalised["positions"].std((0, 1), correction=0), torch.ones(2), atol=1e-4, rtol=0
    )


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"positions": torch.zeros(4, 2)}, r"positions: expected \[9, 2\].*found \[4, 2\]"),
        ({"velocities": torch.full((9, 2), torch.nan)}, r"velocities: .*finite.*sample 0"),
        ({"quality": torch.tensor(3.0)}, r"quality: expected values in \[0, 1\], found 3"),
    ],
)
def test_what_a_subclass_makes_of_a_sample_is_checked(
    changed: dict[str, torch.Tensor], said: str, tmp_path: Path
) -> None:
    class Wrong(TrajectoryDataset):
        def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
            return super().__getitem__(index) | changed

    dataset = Wrong(saved(tmp_path / "p.npz", **l2_arrays()))
    with pytest.raises(DatasetError, match=r"p\.npz, as Wrong returns it: " + said):
        _ = dataset.statistics
