"""The expert's data: solved, every way round, the same bytes from any number of workers."""

import errno
import json
import os
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from anchorflow_models import L2Config, create_l2_safety_cfm
from anchorflow_training.batches import (
    FlowBatchConfig,
    dealt_routes,
    draw_batch,
    mirror,
    prior_means,
    reflection,
)
from anchorflow_training.dataset import (
    DTYPES,
    DatasetError,
    SceneDataset,
    create_arrays,
    open_dataset,
    own_time_states,
)
from anchorflow_training.expert import ExpertConfig, Solution, chosen_by_route, solve
from anchorflow_training.make_data import DataConfig, make_dataset
from anchorflow_trajectory.cost.clearance import GridField
from anchorflow_trajectory.finish.certificate import path_clearance, verify
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.routes.splines import RouteSplines
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline.basis import Splines

CONFIG = DataConfig(scenes=6, seed=3, trajectories=8)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> SceneDataset:
    path = tmp_path_factory.mktemp("data")
    make_dataset(path, CONFIG, workers=2)
    return open_dataset(path)


def test_any_number_of_workers_writes_the_same_bytes(dataset: SceneDataset, tmp_path: Path) -> None:
    make_dataset(tmp_path, CONFIG, workers=1)
    files = {file.name for file in dataset.path.iterdir()}
    assert files == {f"{name}.npy" for name in (*DTYPES, "starts")} | {"dataset.json"}
    for name in files:
        assert (tmp_path / name).read_bytes() == (dataset.path / name).read_bytes()


def test_kept_trajectories_are_good(dataset: SceneDataset) -> None:
    """Clear, within the limits of their own scene, from start to goal."""
    scenes = dataset.batch(np.arange(len(dataset)))
    for index, states in enumerate(scenes["states"]):
        origin, resolution = np.split(scenes["map_geometry"][index], [2])
        field = GridField(scenes["clearance"][index], float(resolution[0]), origin)
        v_max, a_max, _, horizon_s = scenes["limits"][index].tolist()
        position, velocity, acceleration = np.split(states, 3, axis=-1)
        verdict = verify((position, velocity, acceleration), field, MotionLimits(v_max, a_max))
        assert verdict.clearance.min() > 0
        assert verdict.feasible.all()
        x_curr, x_goal = scenes["x_curr"][index], scenes["x_goal"][index]
        np.testing.assert_allclose(states[:, 0], np.tile(x_curr, (8, 1)), atol=5e-4)
        np.testing.assert_allclose(states[:, -1, :4], np.tile(x_goal, (8, 1)), atol=1e-4)
        if horizon_s:
            np.testing.assert_allclose(scenes["durations"][index], horizon_s, rtol=1e-6)
        else:
            assert np.ptp(scenes["durations"][index]) > 0


def test_a_trajectory_lasts_as_long_as_it_says(dataset: SceneDataset) -> None:
    """Its velocity is the derivative of its position by its own clock."""
    scenes = dataset.batch(np.arange(len(dataset)))
    dt = scenes["durations"] / (dataset.num_steps - 1)
    position, velocity = scenes["states"][..., :2], scenes["states"][..., 2:4]
    moved = np.diff(position, axis=2)
    mean = 0.5 * (velocity[:, :, 1:] + velocity[:, :, :-1]) * dt[..., None, None]
    way = np.linalg.norm(moved, axis=-1).sum(2)
    assert (np.linalg.norm(moved - mean, axis=-1).sum(2) < 0.02 * way).all()


def post() -> Scene:
    """Two ways round one post, of which the one below is a little shorter."""
    occupied = np.zeros((96, 96), bool)
    occupied[42:55, 42:54] = True
    layers = [occupied, np.ones_like(occupied), np.zeros_like(occupied)]
    return Scene(
        cost_map=np.stack(layers).astype(np.float32),
        resolution=0.1,
        origin=np.zeros(2),
        robot_radius=0.25,
        x_curr=np.asarray([1.0, 4.8, 0, 0, 0, 0], np.float32),
        x_goal=np.asarray([8.6, 4.8, 0, 0], np.float32),
        w_style=np.asarray([0.4, 0.3, 0.3], np.float32),
        motion=MotionLimits(v_max=2.0, a_max=3.0),
    )


def solved(tether: float = ExpertConfig.tether) -> Solution:
    return solve(post(), config=ExpertConfig(tether=tether), rng=np.random.default_rng(0))


def test_the_expert_passes_a_post_on_both_sides() -> None:
    solution = solved()
    middle = solution.splines.control[1, :, 9]
    assert solution.good.mean() > 0.7
    # Each try ends on the side of the route that it began along.
    lower, upper = (solution.good & (solution.began.route == r) for r in (0, 1))
    assert lower.sum() > 10
    assert upper.sum() > 10
    assert (middle[lower] < 4.2).all()
    assert (middle[upper] > 5.4).all()


def test_a_tether_keeps_tries_apart() -> None:
    """Free, the tries of a route come down to its one best trajectory."""
    apart = []
    for tether in (0.0, 0.2):
        solution = solved(tether=tether)
        good = solution.good & (solution.began.route == 0)
        apart.append(solution.splines.control[:2, good].std(1).mean())
    assert apart[1] > 1.5 * apart[0]


@pytest.mark.parametrize(
    ("good_of_routes", "expected"),
    [
        ((10, 10), [4, 4]),
        ((20, 3, 9), [3, 2, 3]),
        ((20, 1, 1), [6, 1, 1]),
        ((2, 2), [4, 4]),  # few: they repeat
        ((3, 0), [8]),
    ],
)
def test_no_route_drowns_in_another(good_of_routes: tuple[int, ...], expected: list[int]) -> None:
    """Eight are chosen evenly over routes, as far as there are good ones."""
    counts = [*good_of_routes, 5]  # five that are not good, of the first route
    route = np.repeat([*range(len(good_of_routes)), 0], counts)
    good = np.arange(len(route)) < len(route) - 5
    splines = Splines(np.zeros((2, len(route), 18)), np.ones(len(route)))
    began = RouteSplines(splines, route, np.zeros((len(route), 27), np.float32))
    solution = Solution(splines, began, np.zeros(len(route)), np.zeros(len(route)), good)
    chosen = chosen_by_route(solution, 8, rng=np.random.default_rng(0))
    assert good[chosen].all()
    kept = Counter(route[chosen].tolist())
    assert sorted(kept.values()) == sorted(expected)
    uses = Counter(chosen.tolist()).values()
    assert max(uses) - min(uses) <= 1


def test_every_route_of_a_scene_is_in_the_data(tmp_path: Path) -> None:
    """Where each has good tries, their numbers differ by one at most."""
    make_dataset(tmp_path, replace(CONFIG, scenes=12, seed=11), workers=1)
    scenes = open_dataset(tmp_path).batch(np.arange(12))
    even = 0
    for routes, followed in zip(scenes["route_states"], scenes["route"], strict=True):
        count = int(routes.any((1, 2)).sum())
        kept = np.bincount(followed.astype(int), minlength=count)
        assert len(kept) == count
        even += count > 1 and np.ptp(kept) <= 1
    assert even >= 4  # of the 7 with more than one route; in the others some have no good try


def test_starts_are_what_the_tries_began_with() -> None:
    """x_0 of the flow, the route's spline and the disturbance, is the first try's own state."""
    scene, solution = post(), solved()
    began = solution.began
    prior = create_l2_safety_cfm(L2Config(map_size=16, feature_channels=4)).prior
    x_0 = (
        scene.route_states[began.route]
        + prior.disturbed(torch.from_numpy(began.disturbance)).numpy()
    )
    states = scene.basis.own_time_states(began.splines.control)
    for got, wanted in zip(np.split(x_0[..., :-1], 3, -1), np.split(states, 3, -1), strict=True):
        np.testing.assert_allclose(got, wanted, atol=3e-5 * np.abs(wanted).max())
    np.testing.assert_allclose(np.exp(x_0[:, 0, -1]), began.splines.duration, rtol=1e-5)


def test_batches_hold_each_trajectory_equally_often(dataset: SceneDataset) -> None:
    config = FlowBatchConfig(scenes=3, samples=16)
    batch = draw_batch(dataset, config, 0)
    assert batch["states"].shape == (3, 16, 64, 7)
    again = draw_batch(dataset, config, 0)
    for name in batch:
        np.testing.assert_array_equal(batch[name], again[name])
    other = draw_batch(dataset, config, 1)
    assert not np.array_equal(batch["states"], other["states"])
    for scene in batch["states"]:
        _, uses = np.unique(scene, axis=0, return_counts=True)
        assert uses.max() <= 4  # a scene with few good ones has some of its eight twice


def test_a_batch_s_samples_keep_their_own_route_start_and_duration(dataset: SceneDataset) -> None:
    batch = draw_batch(dataset, FlowBatchConfig(scenes=6, samples=16, mirror=False), 0)
    arrays = dataset.batch(np.arange(6))
    every = own_time_states(arrays["states"], arrays["durations"])
    for b in range(6):
        for n in range(16):
            own = np.flatnonzero((every[b] == batch["states"][b, n]).all((1, 2)))
            assert len(own)
            m = own[0]
            np.testing.assert_array_equal(batch["starts"][b, n], arrays["starts"][b, m])
            assert batch["route"][b, n] == arrays["route"][b, m]
            mean = arrays["route_states"][b, int(arrays["route"][b, m])]
            np.testing.assert_array_equal(batch["prior_mean"][b, n], mean)
            lasting = np.exp(batch["states"][b, n, :, -1])
            np.testing.assert_allclose(lasting, arrays["durations"][b, m], rtol=1e-5)


def test_routes_are_dealt_out_in_turn(dataset: SceneDataset) -> None:
    """The routes of a scene, without the zero padding."""
    batch = dataset.batch(np.arange(6))
    counts = batch["route_states"].any((2, 3)).sum(1)
    assert len(set(counts)) > 1
    route = dealt_routes(batch, 7)
    for own, count in zip(route, counts, strict=True):
        np.testing.assert_array_equal(own, np.arange(7) % count)
    assert prior_means(batch, route).any((2, 3)).all()


def test_a_mirrored_scene_is_the_same_problem(dataset: SceneDataset) -> None:
    batch = dataset.batch(np.arange(2))
    mirrored = {k: v.copy() for k, v in batch.items()}
    mirror(mirrored)
    for scenes in (batch, mirrored):
        *origin, resolution = scenes["map_geometry"][0]
        field = GridField(scenes["clearance"][0], float(resolution), np.array(origin))
        scenes["found"] = path_clearance(field, scenes["states"][0])
        route = scenes["route_states"][:1, 0]
        scenes["way"] = path_clearance(field, route[..., :2])
    for name in ("found", "way"):
        np.testing.assert_allclose(batch[name], mirrored[name], atol=1e-5)
    mirror(mirrored)
    for name in ("states", "route_states", "starts"):
        np.testing.assert_allclose(mirrored[name], batch[name])
    np.testing.assert_allclose(mirrored["map_geometry"], batch["map_geometry"], atol=1e-5)


def test_mirrored_starts_begin_mirrored_trajectories(dataset: SceneDataset) -> None:
    """x_0 of the reflection is the reflection of x_0; durations stay."""
    prior = create_l2_safety_cfm(L2Config(map_size=16, feature_channels=4)).prior

    def x_0(batch: dict[str, np.ndarray]) -> np.ndarray:
        disturbed = prior.disturbed(torch.from_numpy(batch["starts"])).numpy()
        return prior_means(batch, batch["route"]) + disturbed

    batch = dataset.batch(np.arange(4))
    assert np.abs(batch["starts"][..., 13:26]).max() > 0.01  # of y
    expected = x_0(batch) * np.append(reflection(2, fields=3), 1.0)
    mirror(batch)
    np.testing.assert_allclose(x_0(batch), expected, atol=1e-4)


def test_a_broken_dataset_names_its_file(dataset: SceneDataset, tmp_path: Path) -> None:
    for file in dataset.path.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    np.save(tmp_path / "x_goal.npy", np.zeros((2, 4)))
    with pytest.raises(DatasetError, match=r"x_goal\.npy.*float32 \[6, \.\.\.\].*float64 \[2, 4\]"):
        open_dataset(tmp_path)
    whole = (dataset.path / "x_goal.npy").read_bytes()
    for damaged in (b"", whole[:-1], whole.replace(b")", b" ", 1)):
        (tmp_path / "x_goal.npy").write_bytes(damaged)
        with pytest.raises(DatasetError, match=r"x_goal\.npy: "):
            open_dataset(tmp_path)
    (tmp_path / "dataset.json").unlink()
    with pytest.raises(DatasetError, match=r"dataset\.json"):
        open_dataset(tmp_path)


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({"ranges": [1]}, r"ranges: expected an object, found \[1\]"),
        ({"ranges": {"v_max": 3}}, r"ranges\.v_max: expected the least and the greatest .* 3"),
        ({"ranges": {"v_max": None}}, r"ranges\.v_max: expected the least .* found None"),
        ({"ranges": {"a_max": [1]}}, r"ranges\.a_max: expected the least .* found \[1\]"),
        ({"ranges": {"a_max": ["1", "2"]}}, r"ranges\.a_max: .* found \['1', '2'\]"),
        ({"ranges": {"a_max": [2, 1]}}, r"ranges\.a_max: .* found \[2, 1\]"),
        ({"ranges": {"a_max": [1, float("nan")]}}, r"ranges\.a_max: .* found \[1, nan\]"),
        ({"limits": 3}, r"limits: expected an object, found 3"),
        ({"limits": {"v_max": "fast", "a_max": 1}}, r"limits\.v_max: expected .* found 'fast'"),
        ({"limits": {"v_max": None, "a_max": 1}}, r"limits\.v_max: expected a number, found None"),
        ({"families": ["walls"]}, r"families: expected an object, found \['walls'\]"),
    ],
)
def test_what_a_dataset_tells_wrong_is_named(
    told: dict, message: str, write_dataset: Callable[[Path], Path], tmp_path: Path
) -> None:
    file = write_dataset(tmp_path) / "dataset.json"
    meta = json.loads(file.read_text())
    file.write_text(json.dumps(meta | {"ranges": None, "families": None}))
    assert open_dataset(tmp_path).limits == MotionLimits(v_max=2.0, a_max=3.0)
    file.write_text(json.dumps(meta | told))
    with pytest.raises(DatasetError, match=rf"{file}: {message}"):
        open_dataset(tmp_path)


def test_a_full_disk_for_what_a_dataset_tells_is_named(tmp_path: Path) -> None:
    (tmp_path / f"dataset.json.{os.getpid()}").symlink_to("/dev/full")
    with pytest.raises(DatasetError, match=r"dataset\.json: expected a place to write .*No space"):
        make_dataset(tmp_path, replace(CONFIG, scenes=1), workers=1)
    assert {file.name for file in tmp_path.iterdir()} == {f"{n}.npy" for n in (*DTYPES, "starts")}


def test_a_folder_that_is_written_anew_is_no_dataset_until_it_is_whole(
    dataset: SceneDataset, tmp_path: Path
) -> None:
    again = Path(shutil.copytree(dataset.path, tmp_path / "again"))
    create_arrays(again, {name: array.shape for name, array in dataset.arrays.items()})
    with pytest.raises(DatasetError, match="expected a dataset"):
        open_dataset(again)


def test_a_dataset_has_its_room_on_the_disk_before_it_is_written(tmp_path: Path) -> None:
    """Else a full disk would end the process at a write to memory, in silence."""
    create_arrays(tmp_path, {"states": (400, 8, 64, 6)})
    found = (tmp_path / "states.npy").stat()
    assert 512 * found.st_blocks >= found.st_size > 4 * 400 * 8 * 64 * 6


def test_a_disk_without_that_room_is_named_and_left_empty(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(DatasetError, match=f"{tmp_path}: .*No space left"):
        create_arrays(tmp_path, {"states": (4, 8, 64, 6)})
    assert list(tmp_path.iterdir()) == []
