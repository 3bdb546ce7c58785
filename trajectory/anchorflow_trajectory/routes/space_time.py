"""The cheapest ways over places and times, among walls and what moves.

A robot that has to be somewhere at a given time moves over a lattice of places and times: in each
layer of time it goes on to a place that its greatest speed reaches. Every place costs the energy of
the way there, and nearness to walls and to what moves. One sweep forwards gives the cheapest way
from the start to every place and time, one backwards that to the end, and their sum the cheapest
way through a place: ways through different places pass what moves in different ways (dynamic
programming; lattices in space and time as in Ziegler & Stiller, IROS 2009).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.compiled import compiled, compiled_part
from anchorflow_trajectory.cost.fields import CostFields
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.movers import Discs, place_at

Nodes = NDArray[np.int64]
Costs = NDArray[np.float32]

MOST_NODES, LEAST_SIZE = 72, 0.04  # a side of the lattice, and m of its cells
FAR = 4  # nodes that a robot in a hurry goes on in a layer
LEAST_LAYERS, MOST_LAYERS = 8, 64
ROOM_STILL = 0.03  # m that a way keeps from what stands still
WEIGHT_STILL, WEIGHT_MOVING = 2.0, 4.0  # m^2/s^2, power that touching costs
NEAR, FADED = 0.2, 0.8  # m in which it falls to 1/e, and beyond which it is 0
SHORT = 12.0  # m/s: energy that a way may cost by which it ends a metre nearer to the goal
NEVER = np.float32(1e9)
VIAS, MOST_VIAS = (0.25, 0.5, 0.75), 8  # shares of the time at which ways differ, and ways for each
APART = 1  # nodes about one that is chosen, through which no other way leads


class Ground(NamedTuple):
    """What a lattice of X x Y places and K layers of time is like.

    still: [X, Y], where walls are; blocked: [2 K + 1, X, Y], by half layers, by what moves too
    charge: [K + 1, X, Y] of being there; surcharge: [X, Y], factor less 1 on the energy of a move
    moves: [M, 2] nodes that a robot goes on in a layer; price: [M] their energy
    """

    still: BoolArray
    blocked: BoolArray
    charge: Costs
    surcharge: Costs
    moves: Nodes
    price: Costs


@dataclass(frozen=True, eq=False)
class SpaceTime:
    """A lattice of places and times about a start, and the cheapest ways from there.

    origin: [2] m, place of the node (0, 0); size: m between nodes; step: s between layers
    costs: [K + 1, X, Y], of the cheapest way from the start
    """

    origin: FloatArray
    size: float
    step: float
    ground: Ground
    costs: Costs

    @staticmethod
    def of(
        fields: CostFields,
        limits: MotionLimits,
        start: FloatArray,
        velocity: FloatArray,
        goal: FloatArray,
        *,
        longest: float,
        hurry: float,
        room: float,
    ) -> SpaceTime:
        """Sweep a lattice from a start [2] m with a velocity [2] m/s, up to the horizon.

        longest: m, of ways to the goal [2] m that stay on the lattice
        hurry: share of v_max that ways reach
        room: m that ways keep from what moves
        """
        assert limits.horizon_s is not None
        field, reach = fields.clearance, hurry * limits.v_max * limits.horizon_s
        corner = field.origin + field.resolution * np.array(field.values.shape[::-1])
        low, high = _passed_by(start, goal, longest)
        low = np.maximum(np.maximum(field.origin, low), start - reach)
        high = np.minimum(np.minimum(corner, high), start + reach)
        size = max(float((high - low).max()) / MOST_NODES, LEAST_SIZE)
        size = min(size, reach / (FAR * LEAST_LAYERS))
        layers = min(round(reach / (FAR * size)), MOST_LAYERS)
        step = limits.horizon_s / layers
        first = np.ceil((low - start) / size)
        shape = (np.floor((high - start) / size) - first).astype(int) + 1
        origin = start + first * size
        places = origin + size * np.moveaxis(np.mgrid[: shape[0], : shape[1]], 0, -1)
        apart = np.full((2 * layers + 1, *shape), NEVER)
        if fields.movers is not None:
            discs = Discs.of(fields.movers, np.float64)
            _paint(discs, origin, size, 0.5 * step, apart)
        ground = _ground(fields, places.astype(np.float32), apart, size, step, room)
        costs, at = np.full((layers + 1, *shape), NEVER), tuple((-first).astype(int))
        ground.blocked[0][at], costs[0][at] = False, 0.0
        begin = np.concatenate([start, velocity], dtype=np.float64)
        barred = _beyond(places, begin, step, float(limits.a_max), len(costs), size)
        _sweep(ground, barred, costs, True)
        return SpaceTime(origin, size, step, ground, costs)

    def node(self, place: FloatArray) -> tuple[int, int]:
        """Return the node nearest to a place [2] m."""
        at = np.rint((place - self.origin) / self.size).astype(int)
        x, y = np.clip(at, 0, np.array(self.costs.shape[1:]) - 1).tolist()
        return x, y

    def nearest_end(self, goal: FloatArray) -> tuple[int, int] | None:
        """Return the node to be at in the end, by its cost and the way that is left to a goal [2].

        None if there is none.
        """
        left = np.full(self.costs.shape[1:], NEVER)
        left[self.node(goal)] = 0.0
        _settle(~self.ground.still, left)
        total = self.costs[-1] + SHORT * self.size * left
        x, y = np.unravel_index(int(total.argmin()), total.shape)
        return (int(x), int(y)) if total[x, y] < NEVER else None

    def ways_to(self, end: tuple[int, int], num_samples: int) -> tuple[FloatArray, FloatArray]:
        """Return ways [P, T, 2] to a node of the last layer, and the velocity [2] m/s there.

        The cheapest comes first, and its is the velocity. There is none to a node that cannot be
        reached in time.
        """
        layers = len(self.costs) - 1
        costs = np.full(self.costs.shape, NEVER)
        barred = self.costs >= NEVER
        if barred[layers][end]:
            return np.empty((0, num_samples, 2), np.float32), np.zeros(2)
        costs[layers][end] = 0.0
        _sweep(self.ground, barred, costs, False)
        ways = {}
        for share in VIAS:
            layer = round(share * layers)
            total = self.costs[layer] + costs[layer]
            for node in _lowest(total):
                before = _traced(self.ground, self.costs, layer, *node, True)
                after = _traced(self.ground, costs, layer, *node, False)
                way = np.concatenate([before[::-1], after[1:]])
                ways.setdefault(way.tobytes(), (total[node], way))
        nodes = np.stack([way for _, way in sorted(ways.values(), key=lambda found: found[0])])
        places = self.origin + self.size * nodes
        at, steps = np.linspace(0.0, layers, num_samples), np.arange(layers + 1)
        drawn = [[np.interp(at, steps, axis) for axis in way.T] for way in places]
        last = (places[0, -1] - places[0, -3]) / (2.0 * self.step)
        return np.array(drawn, np.float32).transpose(0, 2, 1), last


def _passed_by(start: FloatArray, goal: FloatArray, longest: float) -> FloatArray:
    """Return the corners [2, 2] of a box that holds all ways up to a length: an ellipse's."""
    middle, across = 0.5 * (start + goal), goal - start
    # The half axes are longest / 2 along the line and sqrt(longest^2 - |across|^2) / 2 beside it.
    half = 0.5 * np.sqrt(np.maximum(longest**2 - across[::-1] ** 2, 0.0))
    return np.stack([middle - half, middle + half])


def _ground(
    fields: CostFields, places: Costs, apart: Costs, size: float, step: float, room: float
) -> Ground:
    """Return the ground at places [X, Y, 2]; apart: [2 K + 1, X, Y] m from what moves."""
    x, y = np.moveaxis(places, -1, 0)
    clear = fields.clearance.sample(x, y)
    still = clear < ROOM_STILL
    charge = WEIGHT_STILL * np.exp(np.minimum(-clear / (0.5 * NEAR), 0.0))
    charge = charge + WEIGHT_MOVING * np.exp(-np.maximum(apart[::2], 0.0) / NEAR)
    surcharge = np.zeros(clear.shape, np.float32)
    if fields.surcharge is not None:
        surcharge = fields.surcharge.sample(x, y)
    around = np.arange(-FAR, FAR + 1)
    moves = np.stack(np.meshgrid(around, around, indexing="ij"), -1).reshape(-1, 2)
    moves = np.ascontiguousarray(moves[(moves**2).sum(-1) <= FAR**2])
    price = (moves**2).sum(-1) * (size**2 / step)
    charge, price = np.asarray(step * charge, np.float32), price.astype(np.float32)
    return Ground(still, still | (apart < room), charge, surcharge, moves, price)


def _lowest(total: Costs) -> list[tuple[int, int]]:
    """Return the cheapest nodes [X, Y] that lie apart, at most MOST_VIAS, the cheapest first."""
    left, found = total.copy(), []
    while len(found) < MOST_VIAS and left.min() < NEVER:
        x, y = (int(i) for i in np.unravel_index(int(left.argmin()), left.shape))
        found.append((x, y))
        left[max(x - APART, 0) : x + APART + 1, max(y - APART, 0) : y + APART + 1] = NEVER
    return found


@compiled
def _paint(discs: Discs, origin: FloatArray, size: float, step: float, apart: Costs) -> None:
    """Lower the clearance [L, X, Y] m about each disc, up to FADED m from it."""
    layers, width, height = apart.shape
    for j in range(len(discs.radius)):
        for k in range(layers):
            x, y = place_at(discs, j, k * step)
            radius = discs.radius[j] + discs.growth * (k * step)
            reach = radius + FADED
            begin = max(int(np.ceil((x - reach - origin[0]) / size)), 0)
            end = min(int(np.floor((x + reach - origin[0]) / size)), width - 1)
            low = max(int(np.ceil((y - reach - origin[1]) / size)), 0)
            high = min(int(np.floor((y + reach - origin[1]) / size)), height - 1)
            for a in range(begin, end + 1):
                for b in range(low, high + 1):
                    to_x, to_y = origin[0] + a * size - x, origin[1] + b * size - y
                    gap = np.float32(np.sqrt(to_x * to_x + to_y * to_y) - radius)
                    if gap < apart[k, a, b]:
                        apart[k, a, b] = gap


@compiled
def _beyond(
    places: FloatArray,
    begin: FloatArray,
    step: float,
    a_max: float,
    layers: int,
    room: float,
) -> BoolArray:
    """Return which places [X, Y, 2] are out of reach in each layer: [K + 1, X, Y].

    begin: [4], position and velocity
    """
    width, height, _ = places.shape
    beyond = np.empty((layers, width, height), np.bool_)
    for k in range(layers):
        time = k * step
        most = 0.5 * a_max * time * time + room
        at_x, at_y = begin[0] + begin[2] * time, begin[1] + begin[3] * time
        for i in range(width):
            for j in range(height):
                x, y = places[i, j, 0] - at_x, places[i, j, 1] - at_y
                beyond[k, i, j] = x * x + y * y > most * most
    return beyond


@compiled
def _sweep(ground: Ground, barred: BoolArray, costs: Costs, forwards: bool) -> None:
    """Write the cheapest costs [K + 1, X, Y] from those of the first or last layer.

    A layer has FAR nodes about it that nothing passes, and what cannot be passed costs infinity: so
    a move is one loop over all nodes, without branches.
    """
    layers, width, height = costs.shape
    sign, wide = 1 if forwards else -1, height + 2 * FAR
    padded = np.full((6, width + 2 * FAR, wide), np.inf, np.float32)
    inner, flat = padded[:, FAR : FAR + width, FAR : FAR + height], padded.reshape((6, -1))
    # Taken one by one: numba would not know that unpacked rows lie in one piece.
    walls, halves, here = flat[0], flat[1], flat[2]
    dear, best, nothing = flat[3], flat[4], flat[5]
    nothing[:] = 0.0
    inner[0] = _forbidden(ground.still)
    inner[3] = 1.0 + ground.surcharge
    for count in range(layers - 1):
        k = count if forwards else layers - 1 - count
        to = k + sign
        inner[1] = _forbidden(ground.blocked[2 * k + sign])
        inner[2] = costs[k] if forwards else costs[k] + ground.charge[k]
        best[:] = NEVER
        begin, end = _reached(here)
        for m in range(len(ground.moves)):
            a, b = sign * ground.moves[m, 0], sign * ground.moves[m, 1]
            shift = a * wide + b
            half, quarter = (a // 2) * wide + b // 2, round(0.25 * a) * wide + round(0.25 * b)
            last_half, last_quarter = shift - half, shift - quarter
            is_next = a * a + b * b <= 2  # nothing is between neighbours
            passed, between = (nothing, nothing) if is_next else (halves, walls)
            later = shift if forwards else 0
            _lower(
                best[begin + shift : end + shift],
                ground.price[m],
                dear[begin + later : end + later],
                here[begin:end],
                passed[begin + half : end + half],
                passed[begin + last_half : end + last_half],
                between[begin + quarter : end + quarter],
                between[begin + last_quarter : end + last_quarter],
            )
        there = _forbidden(barred[to] | ground.blocked[2 * to])
        if forwards:
            there += ground.charge[to]
        costs[to] = np.minimum(inner[4] + there, NEVER)


@compiled_part
def _lower(
    best: Costs,
    price: np.float32,
    dear: Costs,
    here: Costs,
    half: Costs,
    last_half: Costs,
    quarter: Costs,
    last_quarter: Costs,
) -> None:
    """Lower the costs of nodes to those by a move.

    dear: factor on its price; half, quarter and the last ones: infinite where something is in the
        way
    """
    for n in range(len(best)):
        cost = here[n] + price * dear[n]
        cost += half[n] + last_half[n] + quarter[n] + last_quarter[n]
        best[n] = cost if cost < best[n] else best[n]


@compiled
def _traced(ground: Ground, costs: Costs, layer: int, x: int, y: int, forwards: bool) -> Nodes:
    """Return the nodes [L, 2] of the cheapest way from one to the layer that a sweep began in."""
    sign = -1 if forwards else 1
    way = np.empty(((layer if forwards else len(costs) - 1 - layer) + 1, 2), np.int64)
    way[0] = x, y
    for n in range(1, len(way)):
        k, least = layer + sign * n, np.inf
        for m in range(len(ground.moves)):
            a, b = sign * ground.moves[m, 0], sign * ground.moves[m, 1]
            i, j = x + a, y + b
            if not (0 <= i < costs.shape[1] and 0 <= j < costs.shape[2]):
                continue
            cost = costs[k, i, j]
            if cost >= NEVER:
                continue
            if a * a + b * b > 2:
                c, d, p, q = a // 2, b // 2, round(0.25 * a), round(0.25 * b)
                passed = ground.blocked[2 * k - sign]
                if passed[x + c, y + d] or passed[i - c, j - d]:
                    continue
                if ground.still[x + p, y + q] or ground.still[i - p, j - q]:
                    continue
            later = ground.surcharge[x, y]
            if not forwards:
                later = ground.surcharge[i, j]
                cost += ground.charge[k, i, j]
            cost += ground.price[m] * (1.0 + later)
            if cost < least:
                least = cost
                way[n] = i, j
        x, y = way[n]
    return way


@compiled_part
def _forbidden(places: BoolArray) -> Costs:
    """Return infinity where places [X, Y] are set, and 0 elsewhere."""
    cost = np.zeros(places.shape, np.float32)
    for i in range(places.shape[0]):
        for j in range(places.shape[1]):
            if places[i, j]:
                cost[i, j] = np.inf
    return cost


@compiled_part
def _reached(costs: Costs) -> tuple[int, int]:
    """Return the first of flat costs that there is, and the one after the last."""
    begin, end = len(costs), 0
    for n in range(len(costs)):
        if costs[n] < NEVER:
            begin, end = min(begin, n), n + 1
    return min(begin, end), end


@compiled
def _settle(free: BoolArray, left: Costs) -> None:
    """Lower what is left [X, Y], in cells, until no neighbour gives a shorter way."""
    width, height = left.shape
    diagonal = np.float32(np.sqrt(2.0))
    changed, turn = True, 0
    while changed:
        changed = False
        for p in range(width):
            i = p if turn % 2 == 0 else width - 1 - p
            for q in range(height):
                j = q if turn // 2 % 2 == 0 else height - 1 - q
                if not free[i, j]:
                    continue
                for a in range(max(i - 1, 0), min(i + 2, width)):
                    for b in range(max(j - 1, 0), min(j + 2, height)):
                        way = left[a, b] + (diagonal if a != i and b != j else np.float32(1.0))
                        if way < left[i, j] - np.float32(1e-4):
                            left[i, j], changed = way, True
        turn += 1
