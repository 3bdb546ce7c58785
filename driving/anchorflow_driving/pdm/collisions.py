"""No at-fault collision, and time to collision.

In both a track's first contact with the ego decides: it counts, or the track is forgotten.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.geometry import Array, ahead_of, box_corners, boxes_overlap, wrap_angle
from anchorflow_driving.log import FRAME_S, STATIC
from anchorflow_driving.pdm.traffic import Others, Traffic
from anchorflow_driving.road import Road
from anchorflow_driving.window import Vehicle
from anchorflow_trajectory.car.tracking import Motion

STOPPED = 0.05
"""m/s, at or below which an ego is never at fault, and hitting another always counts."""
TTC_STOPPED = 0.005
"""m/s, below which an ego is not asked about."""
LOOKAHEAD_FRAMES = (0, 3, 6, 9)
AHEAD, BEHIND = np.deg2rad(30.0), np.deg2rad(150.0)
STATIC_PENALTY = 0.5

Integers = NDArray[np.intp]


@dataclass(frozen=True)
class Contacts:
    """Overlaps of the ego's box with others, [M] each."""

    plan: Integers
    step: Integers
    track: Integers
    ahead: Integers  # frames that the other is looked at later

    def of(self, chosen: NDArray) -> Contacts:
        return Contacts(
            self.plan[chosen], self.step[chosen], self.track[chosen], self.ahead[chosen]
        )

    def first_of_each_track(self) -> Contacts:
        """The earliest of each plan with each track, the nearest look-ahead of that step."""
        keys = np.stack([self.ahead, self.step, self.track, self.plan])
        order = np.asarray(np.lexsort(keys), np.intp)
        pair = np.stack([self.plan[order], self.track[order]])
        new = np.ones(len(order), bool)
        new[1:] = (np.diff(pair, axis=1) != 0).any(0)
        return self.of(order[new])


class Placement:
    """The positions of plans' boxes relative to the road; lanes are looked up on demand."""

    def __init__(self, motion: Motion, vehicle: Vehicle, road: Road) -> None:
        self._road, self._axle = road, motion.poses[..., :2]
        self._corners = box_corners(vehicle.middles(motion.poses), vehicle.size)
        self.off_road = np.asarray(~road.is_drivable(self._corners).all(axis=-1))
        """[P, T] a corner is not drivable."""

    def straddles(self, plan: Integers, step: Integers) -> NDArray[np.bool_]:
        """Return [M] whether the box is in several lanes and whole in none, or off the road."""
        inside = self._road.in_lanes(self._corners[plan, step])
        several = (inside.any(-1).sum(0) > 1) & ~inside.all(-1).any(0)
        return several | self.off_road[plan, step]

    def in_junction(self, plan: Integers, step: Integers) -> NDArray[np.bool_]:
        """[M] of the rear axle."""
        return self._road.in_junction(self._road.in_lanes(self._axle[plan, step]))


def no_collision(motion: Motion, traffic: Traffic, placement: Placement) -> tuple[Array, Array]:
    """NC [P] (1; 0.5 where only static objects were hit; 0) and the first fault's step, or inf."""
    others = traffic.others
    contacts = find_contacts(motion, traffic, ahead=0).first_of_each_track()
    contacts = contacts.of(motion.speed[contacts.plan, contacts.step] > STOPPED)
    contacts = contacts.of(_at_fault(contacts, motion, traffic, placement))
    score, first = np.ones(len(motion.poses)), np.full(len(motion.poses), np.inf)
    penalty = np.where(others.kind[contacts.track] == STATIC, STATIC_PENALTY, 0.0)
    np.minimum.at(score, contacts.plan, penalty)
    np.minimum.at(first, contacts.plan, contacts.step)
    return score, first


def time_to_collision(motion: Motion, traffic: Traffic, placement: Placement) -> Array:
    """TTC [P]: 0 where a box ahead is touched within 0.9 s at constant speed and heading.

    Beside the ego counts as ahead while it straddles lanes, leaves the road or crosses a junction.
    """
    found = [find_contacts(motion, traffic, ahead=frames) for frames in LOOKAHEAD_FRAMES]
    contacts = Contacts(
        *(
            np.concatenate([getattr(each, name) for each in found])
            for name in ("plan", "step", "track", "ahead")
        )
    )
    contacts = contacts.of(motion.speed[contacts.plan, contacts.step] >= TTC_STOPPED)
    contacts = contacts.first_of_each_track()
    angle = _bearing(contacts, motion, traffic.others)
    counts = angle < AHEAD
    beside = np.flatnonzero(~counts & (angle <= BEHIND))
    where = contacts.plan[beside], contacts.step[beside]
    counts[beside] = placement.straddles(*where) | placement.in_junction(*where)
    score = np.ones(len(motion.poses))
    score[contacts.plan[counts]] = 0.0
    return score


def find_contacts(motion: Motion, traffic: Traffic, *, ahead: int) -> Contacts:
    """All overlaps, the ego moved on and the others looked at `ahead` frames later."""
    vehicle = traffic.vehicle
    moved = ahead_of(motion.poses, vehicle.rear_axle + motion.speed * (ahead * FRAME_S))
    return _overlaps(moved, vehicle, traffic.others, ahead)


def boxes_touch(poses: Array, vehicle: Vehicle, others: Others) -> NDArray[np.bool_]:
    """[P] whether the box, its middle at poses [P, T, 3] from 0.1 s on, ever overlaps another."""
    hit = np.zeros(len(poses), bool)
    hit[_overlaps(poses, vehicle, others, 1).plan] = True
    return hit


def _overlaps(poses: Array, vehicle: Vehicle, others: Others, ahead: int) -> Contacts:
    """Return where the box at poses [P, T, 3] overlaps others, looked at `ahead` frames later.

    Circles round the boxes are compared first: with what all plans cover at a step, then by plan.
    """
    steps = poses.shape[1]
    place = others.states[:, ahead : ahead + steps, :2]
    reach = (np.hypot(*vehicle.size) + np.hypot(*others.size.T)) / 2
    low, high = poses[..., :2].min(0), poses[..., :2].max(0)
    margin = reach[:, None, None]
    track, step = np.nonzero(((place > low - margin) & (place < high + margin)).all(-1))
    offset = np.abs(poses[:, step, :2] - place[track, step])
    plan, pair = np.nonzero((offset < reach[track][:, None]).all(-1))
    near = Contacts(plan, step[pair], track[pair], np.full(len(plan), ahead))
    states = others.states[near.track, near.step + ahead, :3]
    size = others.size[near.track]
    return near.of(boxes_overlap(poses[plan, near.step], vehicle.size, states, size))


def _at_fault(
    contacts: Contacts, motion: Motion, traffic: Traffic, placement: Placement
) -> NDArray[np.bool_]:
    """Whether a moving ego hit a standing object, hit with its front bumper, or left its lane."""
    others, vehicle = traffic.others, traffic.vehicle
    plan, step, track = contacts.plan, contacts.step, contacts.track
    state = others.states[track, step]
    stands = (others.kind[track] == STATIC) | (np.hypot(state[:, 3], state[:, 4]) <= STOPPED)
    middle = vehicle.middles(motion.poses[plan, step])
    bumper = ahead_of(middle, vehicle.length / 2)
    line = np.array([0.0, vehicle.width])
    fault = stands | boxes_overlap(bumper, line, state[:, :3], others.size[track])
    from_behind = ~stands & (_bearing(contacts, motion, others) > BEHIND)
    fault &= ~from_behind
    lateral = np.flatnonzero(~fault & ~from_behind)
    fault[lateral] = placement.straddles(plan[lateral], step[lateral])
    return fault


def _bearing(contacts: Contacts, motion: Motion, others: Others) -> Array:
    """[M] angle between the ego's heading and the way from its rear axle to the other's middle."""
    pose = motion.poses[contacts.plan, contacts.step]
    other = others.states[contacts.track, contacts.step + contacts.ahead]
    way = np.arctan2(other[:, 1] - pose[:, 1], other[:, 0] - pose[:, 0])
    return np.abs(wrap_angle(way - pose[:, 2]))
