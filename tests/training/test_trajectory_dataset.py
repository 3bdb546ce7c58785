"""Trajectory datasets: derivatives, statistics, rows left out, batches, and clear errors."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from anchorflow_training.data import (
    DatasetError,
    SyntheticTrajectoryDataset,
    TrajectoryDataset,
    TrajectoryStatistics,
    create_dataloader,
)
from anchorflow_training.data.derivatives import central_differences, unwrap_heading
from anchorflow_training.data.synthetic import KINDS

RNG = np.random.default_rng(0)
COUNT, STEPS = 12, 9


def parabolas(dim: int = 2) -> np.ndarray:
    """[N, T, D] with constant accelerations, 0.1 s apart."""
    t = (np.arange(STEPS) * 0.1)[:, None]
    start, speed, acceleration = RNG.normal(size=(3, COUNT, 1, dim))
    return start + speed * t + 0.5 * acceleration * t**2


def l2_arrays(**changed: Any) -> dict[str, Any]:
    return {
        "positions": parabolas(),
        "dt": 0.1,
        "cost_maps": RNG.uniform(size=(COUNT, 2, 16, 20)),
        "start_states": RNG.normal(size=(COUNT, 6)),
        "goal_states": RNG.normal(size=(COUNT, 4)),
        "style_weights": RNG.uniform(0.1, 1.0, (COUNT, 3)),
        "safety_margins": RNG.uniform(size=COUNT),
        "quality": RNG.uniform(size=COUNT),
        "resolution": 0.5,
    } | changed


def saved(path: Path, **arrays: Any) -> Path:
    np.savez(path, **arrays)
    return path


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
        back = getattr(dataset.statistics, name).restore(batch[name].numpy())
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


def test_workers_read_the_same(tmp_path: Path) -> None:
    path = saved(tmp_path / "p.npz", positions=parabolas(), dt=0.1)
    dataset = TrajectoryDataset(path)
    alone, helped = (
        torch.cat([b["positions"] for b in create_dataloader(dataset, 4, workers=workers)])
        for workers in (0, 1)
    )
    torch.testing.assert_close(alone, helped)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dim", [2, 3])
def test_synthetic_derivatives_belong_together(kind: str, dim: int) -> None:
    dataset = SyntheticTrajectoryDataset(kind, 16, num_steps=257, dim=dim, horizon_s=4.0, seed=5)
    sample = dataset.read(slice(None), np.float64)
    assert sample["positions"].shape == (16, 257, dim)
    # The heading of a curve that comes to a halt may jump; its plane does not.
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


def test_a_missing_time_step_is_asked_for(tmp_path: Path) -> None:
    np.save(tmp_path / "p.npy", parabolas())
    with pytest.raises(DatasetError, match=r"p\.npy: dt: .*--dt, --horizon-s"):
        TrajectoryDataset(tmp_path / "p.npy")
    assert TrajectoryDataset(tmp_path / "p.npy", dt=0.1).horizon_s == pytest.approx(0.8)
    arrays = {name: parabolas() for name in ("positions", "velocities", "accelerations")}
    assert TrajectoryDataset(saved(tmp_path / "all.npz", **arrays)).dt is None


@pytest.mark.parametrize(
    "implied",
    [
        {"horizon_s": 0.8},
        {"horizon": 0.8},
        {"horizon_s": np.full(COUNT, 0.8), "dt": np.array([0.1])},
        {"times": 5.0 + 0.1 * np.arange(STEPS)},
    ],
    ids=["horizon_s", "horizon", "one each", "times"],
)
def test_positions_alone_are_differentiated_by_an_implied_step(
    implied: dict[str, Any], tmp_path: Path
) -> None:
    positions = parabolas()
    dataset = TrajectoryDataset(saved(tmp_path / "p.npz", positions=positions, **implied))
    assert dataset.dt == pytest.approx(0.1)
    assert dataset.ignored == ()
    np.testing.assert_allclose(
        dataset[0]["velocities"], central_differences(positions[0], 0.1), rtol=1e-4, atol=1e-5
    )


@pytest.mark.parametrize(
    ("implied", "said"),
    [
        ({"dt": np.arange(COUNT)}, r"dt: expected seconds above 0, found 0\.0 in row 0"),
        (
            {"dt": 0.1 + 0.1 * np.arange(COUNT), "horizon_s": 0.8},
            r"one time step.* found 0\.1 to 1\.2 s from dt, 0\.1 s from horizon_s",
        ),
        ({"times": np.arange(STEPS) ** 2}, r"times: .*evenly spaced, found steps of 1 to 15 s"),
        ({"times": np.arange(STEPS), "dt": 0.1}, r"one time step.*0\.1 s from dt|1 s from times"),
        ({"times": np.arange(STEPS - 1)}, r"times: expected \[9\].*found \[8\]"),
    ],
)
def test_times_that_imply_no_step_are_refused(
    implied: dict[str, Any], said: str, tmp_path: Path
) -> None:
    with pytest.raises(DatasetError, match=said):
        TrajectoryDataset(saved(tmp_path / "p.npz", positions=parabolas(), **implied))


def test_each_row_may_have_a_step_of_its_own(tmp_path: Path) -> None:
    """Its derivatives are by it, whichever rows beside it are left out or asked for."""
    positions, steps = parabolas(), 0.1 + 0.05 * np.arange(COUNT)
    positions[1, 3] = np.nan
    dataset = TrajectoryDataset(saved(tmp_path / "p.npz", positions=positions, dt=steps))
    kept = np.delete(steps, 1)
    assert dataset.horizon_s is None
    assert dataset.durations is not None
    np.testing.assert_allclose(dataset.durations, 8 * kept)
    batch = dataset.samples([3, 0, 5])
    for i, sample in enumerate((3, 0, 5)):
        row = positions[dataset.rows[sample]]
        velocity = np.gradient(row, kept[sample], axis=0, edge_order=2)
        np.testing.assert_allclose(batch["velocities"][i], velocity, rtol=1e-4, atol=1e-5)
    alike = saved(tmp_path / "a.npz", positions=parabolas(), dt=np.full(COUNT, 0.1))
    assert TrajectoryDataset(alike).horizon_s == pytest.approx(0.8)


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


def test_a_row_whose_derivatives_overflow_is_left_out(tmp_path: Path) -> None:
    positions = parabolas()
    positions[4, 3] = 1e39  # finite, but not in float32
    positions[6, ::2] = 1e300
    dataset = TrajectoryDataset(saved(tmp_path / "p.npz", positions=positions, dt=0.1))
    np.testing.assert_array_equal(dataset.left_out, [4, 6])


def test_the_caller_goes_before_the_file(tmp_path: Path) -> None:
    path = saved(tmp_path / "p.npz", positions=parabolas(), dt=0.1)
    assert TrajectoryDataset(path, horizon_s=1.6).dt == pytest.approx(0.2)


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
