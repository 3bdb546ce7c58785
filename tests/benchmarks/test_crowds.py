"""Runs among people get the figures of an independent judge, and drivers avoid the people."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from command_line import succeed

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.crowds.contest import ROBOTS, drive
from anchorflow_benchmarks.crowds.drivers import AnchorDriver, MppiDriver, StraightDriver
from anchorflow_benchmarks.crowds.worlds import (
    CONTACT,
    TICK_S,
    Array,
    Recording,
    World,
    read_recordings,
)

TICKS = 80
ALONG = np.linspace(0.0, 8.0, TICKS + 1)[:, None] * [1.0, 0.0]  # m, from (0, 0) to (8, 0)


@pytest.fixture(scope="module")
def windows(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two windows: with one who stands in the way, and with one who crosses it, and leaves."""
    stands, crosses = np.full((TICKS + 1, 2), [4.0, 0.1]), ALONG[:, ::-1] + [6.0, -2.0]
    crosses[60:] = np.nan
    file = tmp_path_factory.mktemp("people") / "made.npz"
    np.savez(file, ego=[ALONG, ALONG], others=[stands, crosses], count=[1, 1])
    return file


class Parked:
    """A driver without a plan."""

    name = "parked"

    def begin(self, seed: int) -> None:
        pass

    def step(self, world: World, state: Array) -> None:
        pass


def test_who_moves_into_the_other_is_at_fault(windows: Path) -> None:
    standing, _ = read_recordings(windows)
    straight = drive(standing, StraightDriver(), robot=ROBOTS[0])
    assert (straight.contacts, straight.faults, straight.braked) == (1, 1, 0.0)
    assert straight.nearest == pytest.approx(0.1, abs=0.05)

    standing.others = standing.others - ALONG
    parked = drive(standing, Parked(), robot=ROBOTS[0])
    assert (parked.contacts, parked.faults, parked.braked) == (1, 0, 1.0)
    assert parked.short == pytest.approx(8.0)


@pytest.mark.parametrize("robot", ROBOTS)
def test_mppi_passes_and_arrives(windows: Path, robot: str) -> None:
    for recording in read_recordings(windows):
        trip = drive(recording, MppiDriver(), robot=robot)
        assert trip.contacts == 0
        assert trip.nearest > CONTACT
        assert trip.short < 0.5


def test_guidance_climbs_the_reward_of_barriers_to_people() -> None:
    cfm_mppi = pytest.importorskip("anchorflow_benchmarks.crowds.cfm_mppi", exc_type=ImportError)
    rng = np.random.default_rng(0)
    velocities, start = rng.normal(size=(3, 12, 2)), np.array([1.0, -1.0])
    walking = rng.normal(size=(7, 2))
    places = rng.normal(size=(7, 1, 2)) + TICK_S * np.arange(1, 13)[:, None] * walking[:, None]

    def reward(velocities: Array) -> float:
        apart = start + TICK_S * velocities.cumsum(1)[:, None] - places
        closing = velocities[:, None] - walking[:, None]
        kept = 2 * (apart * closing).sum(-1) + (apart**2).sum(-1) - CONTACT**2
        worst = np.sort(np.minimum(kept, 0.0), axis=1)[:, : cfm_mppi.WORST]
        return float((worst * np.arange(cfm_mppi.WORST, 0, -1)[:, None]).sum())

    slope = cfm_mppi.safety_slope(velocities, start, places, walking)
    assert np.abs(slope).max() > 0.1
    for at in np.ndindex(*velocities.shape):
        step = np.zeros_like(velocities)
        step[at] = 1e-6
        found = (reward(velocities + step) - reward(velocities - step)) / 2e-6
        assert slope[at] == pytest.approx(found, abs=1e-4)


def test_cfm_mppi_passes_who_stands_in_the_way(
    windows: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cfm_mppi = pytest.importorskip("anchorflow_benchmarks.crowds.cfm_mppi", exc_type=ImportError)
    monkeypatch.setattr(cfm_mppi, "CROWDS", 4)
    field = cfm_mppi.trained_field(300)
    monkeypatch.setattr(cfm_mppi, "trained_field", lambda: field)
    standing, _ = read_recordings(windows)
    trip = drive(standing, cfm_mppi.CfmMppiDriver(), robot=ROBOTS[0])
    assert (trip.contacts, trip.braked) == (0, 0.0)
    assert trip.short < 1.0


def test_cfm_mppi_plans_no_further_than_its_field() -> None:
    cfm_mppi = pytest.importorskip("anchorflow_benchmarks.crowds.cfm_mppi", exc_type=ImportError)
    others = np.full((1, TICKS + 2, 2), 9.0)
    world = Recording("long", seed=0, start=np.zeros(2), goal=np.ones(2), others=others)
    world.begin()
    with pytest.raises(BenchmarkError, match=r"at most 8 s, got 8\.1"):
        cfm_mppi.CfmMppiDriver().step(world, np.zeros(6))


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_judge_outside_the_project_agrees(
    windows: Path, robot: str, shared_tool: Callable[[str], ModuleType]
) -> None:
    judge = shared_tool("crowds")
    for recording, (_, seed, ego, others) in zip(
        read_recordings(windows), judge.load(windows), strict=True
    ):
        hit, nearest, short, jerk, _, braked = judge.run(
            judge.Straight(), ego, others, seed, robot, 0
        )
        trip = drive(recording, StraightDriver(), robot=robot)
        ours = (trip.hit, trip.nearest, trip.short, trip.jerk, trip.braked)
        np.testing.assert_allclose(ours, (hit, nearest, short, jerk, braked), atol=1e-9)


def test_anchors_see_those_who_are_there(windows: Path) -> None:
    _, crossing = read_recordings(windows)
    crossing.begin()
    engine: Any = None  # which no request needs
    driver = AnchorDriver("discs", engine, num=4, painted=True, pace=True)
    start = np.zeros(6)

    request = driver.request_of(crossing, start, seed=1)
    grid, (person,) = request.cost_map, crossing.positions
    row, column = grid.cell_of(*person)
    assert grid.occupancy[0, row, column] == 1.0
    assert grid.occupancy.sum() * grid.resolution**2 == pytest.approx(np.pi * 0.25**2, abs=0.05)
    assert request.horizon_s == pytest.approx(TICKS * TICK_S)

    for _ in range(70):
        crossing.advance(start)
    assert not driver.request_of(crossing, start, seed=1).cost_map.occupancy.any()


def test_files_of_something_else_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match="found none"):
        read_recordings(tmp_path)
    np.savez(tmp_path / "a.npz", ego=[ALONG], others=[ALONG], count=[2])
    with pytest.raises(BenchmarkError, match="counts do not add up"):
        read_recordings(tmp_path)


def test_the_command_counts_every_window(windows: Path, tmp_path: Path) -> None:
    succeed(
        "bench", "crowds", "--windows", windows, "--drivers", "discs,straight", "--out", tmp_path
    )

    tables = json.loads((tmp_path / "crowds.json").read_text())["tables"]
    found = {table["title"]: table["rows"] for table in tables}
    assert list(found) == ["recorded people", "made"]
    discs, straight = found["made"]
    assert (discs["runs"], discs["hit"]) == (2, 0.0)
    assert (straight["driver"], straight["arrived"]) == ("straight line", 1.0)
    assert straight["collided"] == straight["at fault"] == straight["success"] == 0.5


def test_people_in_rooms_keep_apart_from_walls_and_the_robot() -> None:
    pytest.importorskip("pyrvo", reason="pyrvo is not installed")
    from anchorflow_benchmarks.crowds.rooms import Room, draw_layout, rectangles

    layout = draw_layout(0)
    covered = np.zeros_like(layout.grid.occupied, int)
    for first, top, end, bottom in rectangles(layout.grid.occupied):
        covered[top:bottom, first:end] += 1
    np.testing.assert_array_equal(covered, layout.grid.occupied)

    room = Room(layout, seed=1)
    room.begin()
    began, standing = room.positions.copy(), np.concatenate([room.start, np.zeros(4)])
    for tick in range(150):
        room.advance(standing)
        if tick > 20:
            assert room.wall_distance(room.positions).min() > 0.2
            assert np.linalg.norm(room.positions - room.start, axis=1).min() > CONTACT - 0.05
    assert np.linalg.norm(room.positions - began, axis=1).mean() > 1.0

    room.begin()
    np.testing.assert_array_equal(room.positions, began)
