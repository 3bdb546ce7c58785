"""The guard of cars against an independent judge in fine time steps, and each of its refusals."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from anchorflow_driving.sensors.bev import BevGrid, draw_boxes
from anchorflow_trajectory.guard.faults import BOX, NONE, ROAD, TAKEN, Perceived, Raster
from anchorflow_trajectory.guard.guard import UNDRIVABLE, Guard, Verdict, told
from anchorflow_trajectory.guard.motion import Car
from anchorflow_trajectory.guard.raster_boxes import boxes_in
from anchorflow_trajectory.guard.speeds import boxes_of

Array = NDArray[np.float64]

CAR, TIMES, HORIZON_S = Car(front=3.6, rear=1.0, side=0.9), 0.5 * np.arange(1, 9), 1.5
EXTENT, CELL = (-16.0, 80.0, -32.0, 32.0), 0.5
SHAPE = 192, 128
SCENES = 200
GRID = BevGrid(extent=EXTENT, cell=CELL, ahead_s=())
NOBODY = Raster(np.zeros((1, *SHAPE), np.float32), EXTENT)
ALL_ROAD = Raster(np.ones((1, *SHAPE), np.float32), EXTENT)


def driven(speed: float, pull: Array, curvature: Array) -> Array:
    """Return plans [N,8,3] of cars with these controls [N,8], in steps of 1 cm or so."""
    x, y, heading = np.zeros((3, len(pull)))
    v, poses = np.full(len(pull), speed), []
    for step in range(8):
        for _ in range(50):
            x, y = x + 0.01 * v * np.cos(heading), y + 0.01 * v * np.sin(heading)
            heading = heading + 0.01 * v * curvature[:, step]
            v = np.maximum(v + 0.01 * pull[:, step], 0.0)
        poses.append(np.stack([x, y, heading], -1))
    return np.stack(poses, 1)


def corners(pose: Array, front: float, rear: float, side: float) -> Array:
    """Return the corners [...,4,2] of boxes about poses [...,3]."""
    own = np.array([[front, side], [front, -side], [-rear, -side], [-rear, side]])
    cos, sin = np.cos(pose[..., 2, None]), np.sin(pose[..., 2, None])
    turned = np.stack([cos * own[:, 0] - sin * own[:, 1], sin * own[:, 0] + cos * own[:, 1]], -1)
    return pose[..., None, :2] + turned


def overlap(one: Array, other: Array) -> NDArray[np.bool_]:
    """Whether rectangles [...,4,2] overlap, by their shadows on the directions of their sides."""
    apart = np.zeros(np.broadcast_shapes(one.shape[:-2], other.shape[:-2]), bool)
    for box in (one, other):
        for axis in (box[..., 0, :] - box[..., 3, :], box[..., 0, :] - box[..., 1, :]):
            a, b = ((each * axis[..., None, :]).sum(-1) for each in (one, other))
            apart |= (a.max(-1) < b.min(-1)) | (b.max(-1) < a.min(-1))
    return ~apart


def judged(plans: NDArray[np.floating], boxes: Array, road: Raster) -> NDArray[np.bool_]:
    """Whether plans [N,8,3] hit a box [K,8] within the horizon or leave the road, every 1 cs."""
    times, knots = np.arange(0.0, HORIZON_S + 1e-9, 0.01), np.concatenate([[0.0], TIMES])
    poses = np.concatenate([np.zeros_like(plans[:, :1]), plans], 1)
    fine = np.stack([[np.interp(times, knots, axis) for axis in each.T] for each in poses], 0)
    car = corners(np.moveaxis(fine, 1, -1), CAR.front, CAR.rear, CAR.side)
    row = np.floor((EXTENT[1] - car[..., 0]) / CELL).astype(int)
    column = np.floor((EXTENT[3] - car[..., 1]) / CELL).astype(int)
    shown = (row >= 0) & (row < SHAPE[0]) & (column >= 0) & (column < SHAPE[1])
    is_road = road.values[0][row.clip(0, SHAPE[0] - 1), column.clip(0, SHAPE[1] - 1)] >= 0.5
    wrong = ~(is_road & shown).all((1, 2))
    for x, y, heading, length, width, vx, vy, _ in boxes:
        place = np.stack([x + vx * times, y + vy * times, heading + 0 * times], -1)
        gap = np.hypot(fine[:, 0] - place[:, 0], fine[:, 1] - place[:, 1])
        near = (gap <= np.hypot(CAR.front, CAR.side) + np.hypot(length, width)).any(1)
        wrong[near] |= overlap(car[near], corners(place, length, length, width)).any(1)
    return wrong


def scene(seed: int) -> tuple[float, Array, Array, Raster]:
    """Return a speed, plans [16,8,3], boxes [K,8] and a road."""
    random = np.random.default_rng(seed)
    speed = random.uniform(0.0, 15.0)
    pull = random.uniform(-4.0, 2.0, (16, 1)) + random.normal(0.0, 0.5, (16, 8))
    bend = random.normal(0.0, 0.03, (16, 1)) + random.normal(0.0, 0.005, (16, 8))
    count = random.integers(0, 9)
    heading = random.uniform(-np.pi, np.pi, count)
    fast = random.uniform(-2.0, 18.0, count) * (random.random(count) < 0.6)
    boxes = np.stack(
        [
            random.uniform(-12.0, 60.0, count),
            random.uniform(-15.0, 15.0, count),
            heading,
            random.uniform(0.25, 3.0, count),
            random.uniform(0.25, 1.1, count),
            fast * np.cos(heading),
            fast * np.sin(heading),
            np.zeros(count),
        ],
        -1,
    )
    road = np.ones((1, *SHAPE), np.float32)
    for _ in range(random.integers(0, 4)):
        row, column = random.integers(0, 150), random.integers(0, 120)
        road[0, row : row + random.integers(1, 20), column : column + random.integers(1, 20)] = 0.0
    return speed, driven(speed, pull, bend), boxes, Raster(road, EXTENT)


def drawn(boxes: Array) -> Raster:
    """Return the occupancy now and every half a second later, as GoalFlow takes it."""
    layers = []
    for time in 0.5 * np.arange(10):
        states = boxes[:, [0, 1, 2, 5, 6]] + 0.0
        states[:, :2] += time * boxes[:, 5:7]
        layers.append(draw_boxes(states, 2 * boxes[:, 3:5], GRID) / 255)
    return Raster(np.stack(layers).astype(np.float32), EXTENT, step_s=0.5)


@pytest.mark.parametrize("from_raster", [False, True], ids=["boxes", "raster"])
def test_nothing_that_is_called_safe_hits_a_box_or_leaves_the_road(from_raster: bool) -> None:
    safe, wrong, false = 0, 0, []
    for seed in range(SCENES):
        speed, plans, boxes, road = scene(seed)
        seen = boxes_in(drawn(boxes)) if from_raster else (boxes, NOBODY)
        guard = Guard(TIMES, CAR, speed, Perceived(road, *seen), HORIZON_S)
        verdict, stop, of_stop = guard.with_stop(plans)
        called = np.append(verdict.safe, of_stop.safe)
        bad = judged(np.concatenate([plans, stop]), boxes, road)
        safe, wrong = safe + called.sum(), wrong + bad.sum()
        false += [(seed, *each) for each in np.argwhere(called & bad).tolist()]
    assert not false
    assert safe > 0.3 * 17 * SCENES
    assert wrong > 0.1 * 17 * SCENES


AT_8 = driven(8.0, np.zeros((1, 8)), np.zeros((1, 8)))
STANDS = [0.0, 0.0, 0.0]


def kerb(x: float) -> Raster:
    """A road that ends at x."""
    values = ALL_ROAD.values.copy()
    values[0, : round((EXTENT[1] - x) / CELL)] = 0.0
    return Raster(values, EXTENT)


def taken_at(x: float, seconds: float) -> Raster:
    """Occupancy by layers 0.25 s apart, of one cell on the x axis at one time."""
    values = np.zeros((20, *SHAPE), np.float32)
    values[round(seconds / 0.25), round((EXTENT[1] - x) / CELL), 64] = 1.0
    return Raster(values, EXTENT, step_s=0.25)


@pytest.mark.parametrize(
    ("cause", "speed", "plan", "box", "road", "taken"),
    [
        (NONE, 8.0, AT_8, None, ALL_ROAD, NOBODY),
        (UNDRIVABLE, 3.0, AT_8, None, ALL_ROAD, NOBODY),  # from 3 to 8 m/s at once
        (UNDRIVABLE, 8.0, AT_8 * [1, 1, 0] + [0, 0, 1.5], None, ALL_ROAD, NOBODY),  # it slips
        (ROAD, 8.0, AT_8, None, kerb(14.0), NOBODY),  # before 1.5 s
        (ROAD, 8.0, AT_8, None, kerb(19.0), NOBODY),  # no stop after it
        (NONE, 8.0, AT_8, None, kerb(22.0), NOBODY),
        (BOX, 8.0, AT_8, [14.0, 0.0, 0.3, 1.0, 1.0, *STANDS], ALL_ROAD, NOBODY),
        # It crosses 9 m ahead in 0.1 s, between two poses.
        (BOX, 8.0, AT_8, [9.0, -27.0, 1.57, 0.3, 0.1, 0.0, 36.0, 0.0], ALL_ROAD, NOBODY),
        (NONE, 8.0, AT_8, [9.0, -50.0, 1.57, 0.3, 0.1, 0.0, 36.0, 0.0], ALL_ROAD, NOBODY),
        (BOX, 8.0, AT_8, [20.0, 0.0, 0.0, 1.0, 1.0, *STANDS], ALL_ROAD, NOBODY),  # in braking
        (NONE, 8.0, AT_8, [16.0, 0.0, 0.0, 1.0, 1.0, 8.0, 0.0, 0.0], ALL_ROAD, NOBODY),
        (BOX, 8.0, AT_8, [16.0, 0.0, 0.0, 1.0, 1.0, 8.0, 0.0, 8.0], ALL_ROAD, NOBODY),  # or stands
        (BOX, 8.0, AT_8, [-8.0, 0.0, 0.0, 1.0, 1.0, 14.0, 0.0, 0.0], ALL_ROAD, NOBODY),
        # From behind, when the car brakes after 1.5 s.
        (NONE, 8.0, AT_8, [-14.0, 0.0, 0.0, 1.0, 1.0, 14.0, 0.0, 0.0], ALL_ROAD, NOBODY),
        (TAKEN, 8.0, AT_8, None, ALL_ROAD, taken_at(10.0, 1.0)),
        (NONE, 8.0, AT_8, None, ALL_ROAD, taken_at(10.0, 3.0)),
    ],
)
def test_a_plan_is_refused_for_its_cause(
    cause: int, speed: float, plan: Array, box: list[float] | None, road: Raster, taken: Raster
) -> None:
    boxes = np.array([box] if box else np.zeros((0, 8)))
    guard = Guard(TIMES, CAR, speed, Perceived(road, boxes, taken), HORIZON_S)
    assert guard.judge(plan).cause.tolist() == [cause]


@pytest.mark.parametrize(("x", "deceleration"), [(60.0, 2.0), (16.0, 4.0), (11.5, 7.0)], ids=str)
def test_the_stop_is_the_gentlest_that_is_safe(x: float, deceleration: float) -> None:
    box = np.array([[x, 0.0, 0.0, 1.0, 1.0, *STANDS]])
    guard = Guard(TIMES, CAR, 8.0, Perceived(ALL_ROAD, box, NOBODY), HORIZON_S)
    _, stop, of_stop = guard.with_stop(AT_8)
    assert of_stop.safe.all()
    rate = max(deceleration, 8.0 / 3.9)
    moving = np.minimum(TIMES, 8.0 / rate)
    np.testing.assert_allclose(stop[0, :, 0], 8.0 * moving - rate * moving**2 / 2, atol=1e-9)


def test_a_scene_without_a_safe_plan_says_why() -> None:
    box = np.array([[6.0, 0.0, 0.0, 1.0, 1.0, *STANDS]])
    guard = Guard(TIMES, CAR, 8.0, Perceived(kerb(14.0), box, NOBODY), HORIZON_S)
    aside = driven(8.0, np.zeros((1, 8)), np.full((1, 8), 0.12))
    verdict, _, of_stop = guard.with_stop(np.concatenate([AT_8, aside]))
    assert told(
        Verdict(np.append(verdict.cause, of_stop.cause), np.append(verdict.time, of_stop.time))
    ) == (
        "no trajectory is safe: of 2 trajectories 2 hit a perceived box; "
        f"a stop would hit a perceived box after {of_stop.time[0]:.1f} s"
    )


def test_boxes_of_a_raster_have_their_sizes_and_velocities() -> None:
    velocity = 6.0 * np.cos(0.4), 6.0 * np.sin(0.4)
    boxes = np.array([[20.3, -4.2, 0.4, 2.3, 0.95, *velocity, 0.0]])
    (found,), rest = boxes_in(drawn(boxes))
    assert found[2] % np.pi == pytest.approx(0.4, abs=0.03)
    np.testing.assert_allclose(found[[0, 1]], boxes[0, :2], atol=0.05)
    np.testing.assert_allclose(found[[3, 4]], boxes[0, 3:5] + 0.1, atol=0.06)
    np.testing.assert_allclose(found[5:7], boxes[0, 5:7], atol=0.1)
    assert not rest.values.any()


def test_an_agent_stands_or_drives_as_fast_as_is_foretold() -> None:
    agents = np.array([[20.0, 0.0, 0.0, 4.5, 1.9], [20.0, 10.0, 0.0, 4.5, 1.9]])
    foretold = drawn(np.array([[20.0, 0.0, 0.0, 2.25, 0.95, 8.0, 0.0, 0.0]]))
    moving, standing = boxes_of(agents, foretold)
    slowest, fastest = moving[5] - moving[7], moving[5] + moving[7]
    assert slowest == 0.0
    assert 8.0 <= fastest < 11.0
    np.testing.assert_allclose(standing[5:], 0.0)
