"""Trajectory datasets: derivatives, statistics, rows left out, batches, drawn trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from trajectory_files import COUNT, RNG, STEPS, l2_arrays, parabolas, saved

from anchorflow_training.data import (
    DatasetError,
    SyntheticTrajectoryDataset,
    TrajectoryDataset,
    TrajectoryStatistics,
    create_dataloader,
)
from anchorflow_training.data.statistics import central_differences, unwrap_heading
from anchorflow_training.data.synthetic import KINDS


def test_differences_are_exact_for_parabolas() -> None:
    t = np.linspace(0.0, 2.0, 7)[:, None]
    values = 1.0 - 2.0 * t + 3.0 * t**2
    np.testing.assert_allclose(central_differences(values, 1 / 3), -2.0 + 6.0 * t, atol=1e-12)


def test_missing_derivatives_are_differences(tmp_path: Path) -> None:
    positions = parabolas()
    dataset = TrajectoryDataset(saved(tmp_path / "p.npz", positions=positions, horizon_s=0.8))
    sample = dataset.read(np.arange(COUNT))
    assert dataset.dt == pytest.approx(0.1)
    np.testing.assert_allclose(
        sample["velocities"][:, 1:-1], (positions[:, 2:] - positions[:, :-2]) / 0.2, atol=1e-5
    )
    np.testing.assert_allclose(np.diff(sample["accelerations"], axis=1), 0, atol=1e-4)


def test_given_derivatives_are_kept(tmp_path: Path) -> None:
    velocities = RNG.normal(size=(COUNT, STEPS, 2))
    path = saved(tmp_path / "p.npz", positions=parabolas(), velocities=velocities, dt=0.1)
    sample = TrajectoryDataset(path).read(slice(None))
    np.testing.assert_allclose(sample["velocities"], velocities, rtol=1e-6)
    expected = central_differences(velocities, 0.1)
    np.testing.assert_allclose(sample["accelerations"], expected, rtol=1e-4, atol=1e-5)


def test_a_heading_runs_on_beyond_pi() -> None:
    heading = np.linspace(3.0, 5.0, STEPS)
    wrapped = np.zeros((1, STEPS, 3))
    wrapped[0, :, 2] = (heading + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(unwrap_heading(wrapped)[0, :, 2], heading)
    wrapped[0, :, 2] = heading + 4 * np.pi
    np.testing.assert_allclose(unwrap_heading(wrapped)[0, :, 2], heading)


def test_arrays_in_memory_are_as_a_file_of_them(tmp_path: Path) -> None:
    arrays = l2_arrays()
    read = TrajectoryDataset(saved(tmp_path / "l2.npz", **arrays)).read(slice(None))
    tensors = {name: torch.as_tensor(np.asarray(values)) for name, values in arrays.items()}
    for held in (arrays, tensors):
        found = TrajectoryDataset.from_arrays(held)
        assert len(found) == COUNT
        for name, values in found.read(slice(None)).items():
            np.testing.assert_array_equal(values, read[name])
    with pytest.raises(DatasetError, match=r"mine: goal_states: expected \[\d+, 4\]"):
        TrajectoryDataset.from_arrays({**arrays, "goal_states": np.zeros(3)}, name="mine")


def test_rows_that_are_not_finite_are_left_out_and_named(tmp_path: Path) -> None:
    arrays = l2_arrays()
    arrays["positions"][3, 4, 1] = np.nan
    arrays["positions"][7, 0, 0] = np.inf
    arrays["goal_states"][5, 2] = np.nan
    dataset = TrajectoryDataset(saved(tmp_path / "p.npz", **arrays))
    np.testing.assert_array_equal(dataset.left_out, [3, 5, 7])
    np.testing.assert_array_equal(dataset.not_finite["positions"], [3, 7])
    np.testing.assert_array_equal(dataset.not_finite["goal_states"], [5])
    assert len(dataset) == COUNT - 3
    np.testing.assert_array_equal(dataset.rows[:5], [0, 1, 2, 4, 6])
    everything = dataset.read(slice(None))
    assert all(np.isfinite(values).all() for values in everything.values())
    np.testing.assert_allclose(everything["positions"][3], arrays["positions"][4], rtol=1e-6)


def test_statistics_are_those_of_the_samples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("anchorflow_training.data.trajectory_dataset.BLOCK_BYTES", 1000)
    positions = parabolas() + 4e5  # a map's coordinates, far from their origin
    positions[2] = np.nan
    dataset = TrajectoryDataset(saved(tmp_path / "p.npz", positions=positions, dt=0.1))
    good = np.delete(positions, 2, 0)
    found = dataset.statistics.positions
    np.testing.assert_allclose(found.mean, good.mean((0, 1)))
    np.testing.assert_allclose(found.std, good.std((0, 1)))
    np.testing.assert_allclose(found.min, good.min((0, 1)))
    np.testing.assert_allclose(found.max, good.max((0, 1)))
    assert dataset.statistics.count == COUNT - 1
    speed = np.linalg.norm(central_differences(good, 0.1), axis=-1).max(1)
    np.testing.assert_allclose(dataset.peak_speed, speed, rtol=1e-4)
    assert TrajectoryStatistics.from_dict(dataset.statistics.to_dict()) == dataset.statistics


def test_normalised_batches_have_unit_spread() -> None:
    dataset = SyntheticTrajectoryDataset("bezier", 64)
    batch = next(iter(create_dataloader(dataset, 64, normalise=True)))
    for name in ("positions", "velocities", "accelerations"):
        torch.testing.assert_close(batch[name].mean((0, 1)), torch.zeros(2), atol=1e-4, rtol=0)
        torch.testing.assert_close(
            batch[name].std((0, 1), correction=0), torch.ones(2), atol=1e-4, rtol=0
        )
        found = getattr(dataset.statistics, name)
        back = batch[name].numpy() * found.std + found.mean
        assert np.abs(back).max() <= np.abs(dataset.read(slice(None))[name]).max() + 1e-3


def test_other_statistics_may_be_kept(tmp_path: Path) -> None:
    training = SyntheticTrajectoryDataset("sine", 8)
    path = saved(tmp_path / "p.npz", positions=parabolas(), dt=0.1)
    dataset = TrajectoryDataset(path, statistics=training.statistics)
    assert dataset.statistics == training.statistics


def test_l2_arrays_come_in_every_batch(tmp_path: Path) -> None:
    arrays = l2_arrays()
    dataset = TrajectoryDataset(saved(tmp_path / "l2.npz", **arrays))
    loader = create_dataloader(dataset, 5, shuffle=False)
    batches = list(loader)
    assert [len(batch["positions"]) for batch in batches] == [5, 5, 2]
    joined = {name: torch.cat([b[name] for b in batches]).numpy() for name in batches[0]}
    for name in ("cost_maps", "start_states", "goal_states", "style_weights", "quality"):
        np.testing.assert_allclose(joined[name], arrays[name], rtol=1e-6)
    assert all(tensor.dtype == torch.float32 for tensor in batches[0].values())
    torch.testing.assert_close(dataset[1]["positions"], batches[0]["positions"][1])
    torch.testing.assert_close(dataset[-1]["positions"], batches[-1]["positions"][-1])
    with pytest.raises(IndexError):
        dataset[COUNT]


def test_cost_maps_in_8_bits_are_scaled(tmp_path: Path) -> None:
    maps = RNG.integers(0, 256, (COUNT, 1, 16, 16)).astype(np.uint8)
    dataset = TrajectoryDataset(saved(tmp_path / "l2.npz", **l2_arrays(cost_maps=maps)))
    np.testing.assert_allclose(dataset.read(slice(None))["cost_maps"], maps / 255, rtol=1e-6)


def test_cost_maps_in_8_bits_may_be_free_throughout(tmp_path: Path) -> None:
    maps = np.zeros((COUNT, 1, 16, 16), np.uint8)
    assert len(TrajectoryDataset(saved(tmp_path / "free.npz", **l2_arrays(cost_maps=maps))))


def test_a_seed_fixes_the_order_of_every_epoch() -> None:
    dataset = SyntheticTrajectoryDataset("bezier", 30)

    def epochs(seed: int) -> list[torch.Tensor]:
        loader = create_dataloader(dataset, 8, seed=seed)
        return [torch.cat([batch["positions"] for batch in loader]) for _ in range(2)]

    first, second = epochs(1)
    assert not torch.equal(first, second)
    torch.testing.assert_close(epochs(1), [first, second])
    assert not torch.equal(epochs(2)[0], first)
    last = list(create_dataloader(dataset, 8, drop_last=True))[-1]
    assert len(last["positions"]) == 8


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dim", [2, 3])
def test_synthetic_derivatives_belong_together(kind: str, dim: int) -> None:
    dataset = SyntheticTrajectoryDataset(kind, 16, num_steps=257, dim=dim, horizon_s=4.0, seed=5)
    sample = dataset.read(slice(None), np.float64)
    assert sample["positions"].shape == (16, 257, dim)
    # The heading of a curve may jump at a halt; its position does not.
    p, v, a = (sample[n][..., :2] for n in ("positions", "velocities", "accelerations"))
    np.testing.assert_allclose(central_differences(p, 4 / 256), v, atol=2e-3)
    np.testing.assert_allclose(central_differences(v, 4 / 256), a, atol=2e-3)
    if dim == 3:
        moving = np.linalg.norm(v, axis=-1) > 0.1
        ahead = np.stack([np.cos(sample["positions"][..., 2]), np.sin(sample["positions"][..., 2])])
        along = (v * np.moveaxis(ahead, 0, -1)).sum(-1) / np.linalg.norm(v, axis=-1)
        np.testing.assert_allclose(along[moving], 1.0, atol=1e-6)
    same = SyntheticTrajectoryDataset(kind, 16, num_steps=257, dim=dim, horizon_s=4.0, seed=5)
    np.testing.assert_array_equal(
        same.read(slice(None), np.float64)["positions"], sample["positions"]
    )
    other = SyntheticTrajectoryDataset(kind, 16, num_steps=257, dim=dim, horizon_s=4.0, seed=6)
    assert not np.array_equal(other.read(slice(None))["positions"], sample["positions"])


def test_synthetic_kinds_are_named() -> None:
    with pytest.raises(DatasetError, match=r"kind: expected one of bezier, polynomial, sine"):
        SyntheticTrajectoryDataset("spiral")


def test_other_names_of_the_same_arrays_are_taken(tmp_path: Path) -> None:
    arrays = l2_arrays()
    ours = TrajectoryDataset(saved(tmp_path / "a.npz", **arrays))
    arrays["trajectories"] = arrays.pop("positions")
    arrays["trajectory_quality"] = arrays.pop("quality")
    theirs = TrajectoryDataset(saved(tmp_path / "b.npz", **arrays))
    assert theirs.ignored == ()
    torch.testing.assert_close(theirs[2], ours[2])
    arrays["positions"] = arrays["trajectories"]
    with pytest.raises(DatasetError, match=r"expected positions or trajectories, found both"):
        TrajectoryDataset(saved(tmp_path / "c.npz", **arrays))


def test_a_row_whose_derivatives_overflow_is_left_out(tmp_path: Path) -> None:
    positions = parabolas()
    positions[4, 3] = 1e39  # finite, but not in float32
    positions[6, ::2] = 1e300
    dataset = TrajectoryDataset(saved(tmp_path / "p.npz", positions=positions, dt=0.1))
    np.testing.assert_array_equal(dataset.left_out, [4, 6])


def test_map_geometry(tmp_path: Path) -> None:
    centred = TrajectoryDataset(saved(tmp_path / "a.npz", **l2_arrays()))
    found = centred.map_geometry(np.array([3]))
    assert found is not None
    np.testing.assert_allclose(found, [[-5.0, -4.0, 0.5]])  # W 20, H 16
    origin, resolution = RNG.normal(size=(COUNT, 2)), RNG.uniform(0.1, 1, COUNT)
    path = saved(tmp_path / "b.npz", **l2_arrays(origin=origin, resolution=resolution))
    found = TrajectoryDataset(path).map_geometry(np.array([3, 1]))
    assert found is not None
    np.testing.assert_allclose(found[:, :2], origin[[3, 1]])
    np.testing.assert_allclose(found[:, 2], resolution[[3, 1]])


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
