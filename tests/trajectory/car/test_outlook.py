"""What plans are worth by what is perceived: occupancy, small things, road and course."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.outlook import Sight, worth
from anchorflow_trajectory.car.route_drives import OFFSETS, RATES, route_drives
from anchorflow_trajectory.car.small_things import SmallThings
from anchorflow_trajectory.car.tracking import EgoState, interpolate, track
from anchorflow_trajectory.guard.faults import Raster
from anchorflow_trajectory.guard.motion import Car

CAR, SPEED = Car(3.6, 1.0, 0.9), 8.0
STREET = Course(np.array([[0.0, 0.0], [100.0, 0.0]]))
AHEAD, LIDAR = (-32.0, 72.0, -32.0, 32.0), (-32.0, 32.0, -32.0, 32.0)
FREE = Raster(np.zeros((20, 104, 64), np.float32), AHEAD, 0.25, 0.25)
ROAD = Raster(np.ones((1, 128, 256), np.float32), (0.0, 32.0, -32.0, 32.0))
NOTHING = SmallThings(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
CLEAR = Sight(FREE, ROAD, NOTHING)
DRIVES = route_drives(STREET, SPEED, top_speed=10.0)


def values(sight: Sight, *, speed: float = SPEED, drives: np.ndarray = DRIVES) -> np.ndarray:
    poses = np.concatenate([np.zeros((len(drives), 1, 3)), drives], 1)
    start = EgoState(np.zeros(3), speed, 0.0, 0.0)
    motion = track(interpolate(poses), start, wheelbase=2.7)
    return worth(motion, CAR, sight, STREET)


def best(sight: Sight) -> tuple[float, float]:
    """Return the offset and the rate of the best drive."""
    offset, rate = divmod(int(values(sight).argmax()), len(RATES))
    return OFFSETS[offset], RATES[rate]


def taken(x: tuple[float, float], *, moving: float = 0.0, share: float = 0.9) -> Raster:
    """Return occupancy over the whole street between two x, which move on (m/s)."""
    layers, middles = np.zeros((20, 104, 64), np.float32), 71.5 - np.arange(104)
    for layer, rows in enumerate(layers):
        low, high = (each + moving * 0.25 * (layer + 1) for each in x)
        rows[(middles > low) & (middles < high)] = share
    return replace(FREE, values=layers)


def small(x: float, y: float, vy: float = 0.0) -> Sight:
    things = SmallThings(np.array([[x, y]]), np.array([[0.0, vy]]), np.array([0.3]))
    return replace(CLEAR, things=things)


def test_on_a_free_street_the_fastest_is_best_in_the_middle() -> None:
    assert best(CLEAR) == (0.0, RATES[0])


@pytest.mark.parametrize(("x", "rate"), [((20.0, 24.0), -1.5), ((14.0, 18.0), -2.5)])
def test_it_brakes_before_predicted_occupancy(x: tuple[float, float], rate: float) -> None:
    assert best(replace(CLEAR, taken=taken(x)))[1] <= rate


def test_who_drives_on_ahead_is_followed_and_who_is_doubtful_counts_less() -> None:
    assert best(replace(CLEAR, taken=taken((17.0, 21.0), moving=8.0)))[1] >= -0.75
    assert best(replace(CLEAR, taken=taken((14.0, 18.0), share=0.05))) == (0.0, RATES[0])


def test_it_keeps_the_time_to_those_ahead_in_which_they_may_stop() -> None:
    close = replace(CLEAR, taken=taken((9.0, 13.0), moving=8.0))
    assert best(close)[1] <= -1.5
    fades = [0.9 * 0.75**layer for layer in range(20)]  # as predicted occupancy does
    slowing = taken((20.0, 24.0), moving=3.0)
    slowing.values[...] *= np.array(fades, np.float32)[:, None, None] / 0.9
    rates = values(replace(CLEAR, taken=slowing))[: len(RATES)]
    assert rates[RATES.index(0.0)] < 0.01 < rates.max()


def test_who_walks_out_of_the_way_may_stop_in_it() -> None:
    fastest = values(small(16.0, 0.8, vy=1.5))[0]
    assert fastest < 1e-3


def test_it_stops_for_small_things_and_for_those_that_walk_into_its_way() -> None:
    assert best(small(16.0, 0.0))[1] <= -1.5
    assert best(small(30.0, 8.0)) == (0.0, RATES[0])
    walking = values(small(14.0, -4.0, vy=2.0))
    standing = values(small(14.0, -4.0))
    fastest = OFFSETS.index(0.0) * len(RATES)
    assert walking[fastest] < 0.1 * standing[fastest]
    assert values(small(16.0, 0.0))[fastest] < 1e-3


def test_the_road_decides_between_paths() -> None:
    narrow = ROAD.values.copy()
    narrow[:, :, 128 + 6 :] = 0.0  # all that is 1.5 m to the right
    beside = values(replace(CLEAR, road=replace(ROAD, values=narrow))).reshape(3, -1)
    assert beside[OFFSETS.index(1.0)].max() > 5 * beside[OFFSETS.index(-1.0)].max()


def test_the_other_arm_of_a_course_that_crosses_itself_is_no_progress() -> None:
    loop = [[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [10.0, 20.0], [10.0, -40.0]]
    x = np.linspace(0.0, 10.0, 9)[1:]
    turned = np.stack([x, -np.maximum(x - 5.0, 0.0), np.where(x > 5.0, -0.8, 0.0)], -1)
    ahead = np.stack([x, 0 * x, 0 * x], -1)
    poses = np.concatenate([np.zeros((2, 1, 3)), [turned, ahead]], 1)
    motion = track(interpolate(poses), EgoState(np.zeros(3), 2.5, 0.0, 0.0), wheelbase=2.7)
    astray, on = worth(motion, CAR, CLEAR, Course(np.array(loop)))
    assert astray < on


def test_creeping_is_no_progress() -> None:
    slow = route_drives(STREET, 0.15, top_speed=8.0)
    worths = values(CLEAR, speed=0.15, drives=slow)
    creeping, standing = worths[RATES.index(0.0)], worths[RATES.index(-6.0)]
    assert creeping <= 1.01 * standing
    assert worths[0] > 2 * standing


def test_of_plans_that_all_hit_something_the_one_that_brakes_hardest_is_best() -> None:
    assert best(replace(CLEAR, taken=taken((3.0, 9.0))))[1] == RATES[-1]


def test_a_plan_off_the_course_is_worth_less() -> None:
    away = np.linspace(0.0, 1.0, 8)[:, None] * np.array([[[0.0, m, 0.0]] for m in (0.0, 4.0, 8.0)])
    on, off, further = values(CLEAR, drives=DRIVES[:1] + away)
    assert off < 0.5 * on
    assert further < 0.5 * off


def lidar(*boxes: tuple[float, float, float, float], count: float = 1.0) -> Raster:
    """Return a sweep with points between the x and y of boxes."""
    cells, x = np.zeros((1, 256, 256), np.float32), 31.875 - 0.25 * np.arange(256)
    for low_x, high_x, low_y, high_y in boxes:
        rows, columns = (x > low_x) & (x < high_x), (x > low_y) & (x < high_y)
        cells[0] = np.where(rows[:, None] & columns, count, cells[0])
    return Raster(cells, LIDAR)


def test_a_person_is_seen_with_his_velocity() -> None:
    now, before = lidar((10.0, 10.5, 2.0, 2.5)), lidar((10.0, 10.5, 1.25, 1.75))
    seen = SmallThings.seen(now, before, FREE, CAR)
    np.testing.assert_allclose(seen.places, [[10.25, 2.25]])
    np.testing.assert_allclose(seen.velocities, [[0.0, 1.5]])
    assert 0.3 <= seen.radii[0] < 0.4
    alone = SmallThings.seen(now, None, FREE, CAR)
    np.testing.assert_allclose(alone.velocities, [[0.0, 0.0]])


def test_what_occupancy_explains_or_the_car_is_itself_is_no_thing() -> None:
    now = lidar((10.0, 10.5, 2.0, 2.5), (1.0, 2.0, -0.5, 0.5))
    assert not len(SmallThings.seen(now, None, taken((8.0, 12.0)), CAR).radii)
    assert len(SmallThings.seen(now, None, taken((14.0, 18.0)), CAR).radii) == 1
    flank = lidar((8.5, 14.0, 1.0, 1.5))  # half of its points explain the others
    assert not len(SmallThings.seen(flank, None, taken((11.0, 16.0)), CAR).radii)
    assert len(SmallThings.seen(flank, None, taken((16.0, 20.0)), CAR).radii)


def test_a_wide_group_may_be_the_rear_of_a_vehicle_that_moves_on() -> None:
    rear, before = lidar((10.0, 10.5, -0.8, 0.8)), lidar((6.0, 6.5, -0.8, 0.8))
    assert not len(SmallThings.seen(rear, None, taken((12.5, 16.0)), CAR).radii)
    assert len(
        SmallThings.seen(lidar((10.0, 10.5, 0.0, 0.5)), None, taken((12.5, 16.0)), CAR).radii
    )
    unknown = SmallThings.seen(rear, before, FREE, CAR)  # its points have the group's velocity
    np.testing.assert_allclose(unknown.velocities, np.tile([8.0, 0.0], (2 * 6, 1)))
    person = lidar((10.0, 10.5, 0.0, 0.5)), lidar((6.0, 6.5, 0.0, 0.5))
    np.testing.assert_allclose(SmallThings.seen(*person, FREE, CAR).velocities, [[0.0, 0.0]])


def test_things_far_from_the_course_do_not_count() -> None:
    places = np.array([[10.0, 0.0], [10.0, 30.0], [5.0, 2.0]])
    near = SmallThings(places, np.zeros((3, 2)), np.ones(3)).near(STREET)
    np.testing.assert_array_equal(near.places, places[[2, 0]])


def test_single_points_are_noise_and_long_things_are_points() -> None:
    assert not len(SmallThings.seen(lidar((9.9, 10.2, 2.0, 2.3), count=0.2), None, FREE, CAR).radii)
    wall = SmallThings.seen(lidar((5.0, 15.0, 4.0, 4.5)), None, FREE, CAR)
    assert len(wall.radii) == 40 * 2
    assert wall.radii.max() < 0.2
