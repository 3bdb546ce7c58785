"""The time step of a trajectory file: told, implied, or of each row its own."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trajectory_files import COUNT, STEPS, parabolas, saved

from anchorflow_training.data import DatasetError, TrajectoryDataset
from anchorflow_training.data.statistics import central_differences


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
    """Each row's derivatives use its own step, whichever rows are read."""
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


def test_the_caller_goes_before_the_file(tmp_path: Path) -> None:
    path = saved(tmp_path / "p.npz", positions=parabolas(), dt=0.1)
    assert TrajectoryDataset(path, horizon_s=1.6).dt == pytest.approx(0.2)
