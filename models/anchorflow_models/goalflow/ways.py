"""Ways of a car's rear axle: by its controls, along arcs, and along a route.

Ways along a route are those of pure pursuit (Coulter, CMU-RI-TR-92-01). A route is P = ROUTE_POINTS
places, ROUTE_SPACING_M apart, as `anchorflow_client.sensors` makes it.
"""

from __future__ import annotations

from itertools import chain

import torch
from torch import Tensor

from anchorflow_client.sensors import ROUTE_POINTS, ROUTE_SPACING_M
from anchorflow_models.goalflow.config import ASIDE, HALTINGS, PACES

SUBSTEPS = 4
"""Integration steps between two poses."""
BRAKING, PULLING = 6.0, 2.3
"""m/s², of the acceleration that is drawn."""
SHARPEST = 0.2
"""1/m, of the curvature."""
GRIP = 8.0
"""m/s² to the side, of what is drawn at any speed."""
LEADINGS = 6
"""Fixed-point steps of `led_to`."""
_LEAST = 1e-3
SETTING_OFF, SLOWING = 1.5, 3.0  # m/s², at most
ROUTE_LEANING = 1.6  # m/s² to the side, at most, in a route's bends
EASING = 1.0  # m/s², by which it slows down before a bend
ROUTE_SHARPEST = 0.3  # 1/m, of ways along a route, whose corners are those of the map
STEERS_S = 0.4  # s, delay of the steering
LOOKS_S, NEAREST = 0.6, 2.5  # s and m, at least, from the car to the point that it steers for
STRETCHES = 2  # of constant controls, between two poses
FOLLOWS = 2.0  # m from a route, at which half as much is left of a score


def roll_out(speed: Tensor, acceleration: Tensor, curvature: Tensor, *, dt: float) -> Tensor:
    """Poses [..., T, 3] (x, y, heading) of a car that starts at the origin along x.

    speed: [...] m/s now; it does not fall below 0
    acceleration, curvature: [..., T] m/s², 1/m, each constant until its pose
    """
    step = dt / SUBSTEPS
    fine = acceleration.repeat_interleave(SUBSTEPS, -1)
    # What braking would take below 0 is not paid back by who drives off again.
    owed = speed[..., None] + step * fine.cumsum(-1)
    so_far = torch.ones(2 * owed.shape[-1:], dtype=torch.bool, device=owed.device).tril()
    after = owed - torch.where(so_far, owed[..., None, :], 0.0).amin(-1).clamp(max=0.0)
    before = torch.cat([speed[..., None], after[..., :-1]], -1)
    way = step * 0.5 * (before + after)
    turn = way * curvature.repeat_interleave(SUBSTEPS, -1)
    heading = turn.cumsum(-1)
    course = heading - 0.5 * turn
    x, y = ((way * part).cumsum(-1) for part in (course.cos(), course.sin()))
    poses = torch.stack([x, y, heading], -1)
    return poses[..., SUBSTEPS - 1 :: SUBSTEPS, :]


def sharpest_at(speed: Tensor, acceleration: Tensor, *, dt: float) -> Tensor:
    """Curvature [..., T] in 1/m that tyres let a car of speeds [...] drive, by [..., T] m/s²."""
    after = speed[..., None] + dt * acceleration.cumsum(-1)
    fastest = torch.maximum(after, after - dt * acceleration).clamp(min=(GRIP / SHARPEST) ** 0.5)
    return GRIP / fastest.square()


def within(curvature: Tensor, sharpest: Tensor) -> Tensor:
    """Curvatures that bend to either side by no more than the sharpest, 1/m, by broadcasting."""
    return torch.minimum(torch.maximum(curvature, -sharpest), sharpest)


def arc_to(goal: Tensor, speed: Tensor, *, duration: float) -> tuple[Tensor, Tensor]:
    """Return constant acceleration and curvature [...] of the arc that ends at goals [..., 2].

    speed: [...] m/s now; a car that cannot reach the goal at a speed above 0 halts there
    """
    x, y = goal[..., 0], goal[..., 1]
    square = (x.square() + y.square()).clamp(min=_LEAST)
    curvature = (2 * y / square).clamp(-SHARPEST, SHARPEST)
    chord = square.sqrt()
    # Half the arc's angle; a chord is as long as the arc times sinc of it.
    half = (0.5 * curvature * chord).clamp(-0.999, 0.999).asin()
    bent = half.abs() > _LEAST
    way = chord * torch.where(bent, half / half.sin().where(bent, 1.0), 1.0)
    meeting = 2 * (way - speed * duration) / duration**2
    halting = -speed.square() / (2 * way.clamp(min=_LEAST))
    acceleration = torch.where(way < 0.5 * speed * duration, halting, meeting)
    return acceleration.clamp(-BRAKING, PULLING), curvature


def led_to(
    goal: Tensor,
    poses: Tensor,
    speed: Tensor,
    acceleration: Tensor,
    curvature: Tensor,
    *,
    dt: float,
) -> Tensor:
    """Return the poses [..., T, 3] of a car whose controls are shifted so that it ends at goals
    [..., 2].

    poses: [..., T, 3], as `roll_out` gives for speeds and controls [..., T]

    One number is added to all accelerations and one to all curvatures, within what is driven at
    all, by fixed-point steps in the polar coordinates of the end: its distance follows the first,
    its direction half an arc's angle of the second.
    """
    away = goal.square().sum(-1).clamp(min=_LEAST).sqrt()
    bearing = torch.atan2(goal[..., 1], goal[..., 0])
    faster = sharper = torch.zeros_like(away)
    later = dt * acceleration.shape[-1]
    for _ in range(LEADINGS):
        x, y = poses[..., -1, 0], poses[..., -1, 1]
        short = away - (x.square() + y.square()).clamp(min=_LEAST).sqrt()
        turned = bearing - torch.atan2(y, x)
        faster = faster + 2 * short / later**2
        sharper = sharper + 2 * torch.atan2(turned.sin(), turned.cos()) / away
        pull = (acceleration + faster[..., None]).clamp(-BRAKING, PULLING)
        bend = (curvature + sharper[..., None]).clamp(-SHARPEST, SHARPEST)
        poses = roll_out(speed, pull, within(bend, sharpest_at(speed, pull, dt=dt)), dt=dt)
    return poses


def is_told(route: Tensor) -> Tensor:
    """[B], whether there is a route [B, P, 2]: of one that is not, all places are the same."""
    return (route - route[:, :1]).abs().amax((1, 2)) > 0


def ways_along(
    route: Tensor, speed: Tensor, curvature: Tensor, *, steps: int, dt: float
) -> tuple[Tensor, Tensor]:
    """Poses [B, W, T, 3] of ways along routes [B, P, 2], of cars at speeds [B] in bends of
    curvatures [B], and their controls [B, W, T, 2]: acceleration and curvature.

    A car steers for a point ahead on the route, as fast as it can, so that it comes back to it from
    wherever it is, and slows down before bends. First come those that go on, on the route itself,
    then those that halt on it, then those beside it.
    """
    heading = _headings(route)
    normal = torch.stack([-heading.sin(), heading.cos()], -1)
    track = torch.cat([route, normal], -1)
    allowed = _allowed(heading)
    halts = [(0.0, braking, 0.0) for braking in HALTINGS]
    on_it, *beside_it = ([(pace, SLOWING, aside) for pace in PACES] for aside in ASIDE)
    asked = [*on_it, *halts, *chain(*beside_it)]
    pace, slowing, aside = torch.tensor(asked).to(speed).unbind(-1)
    now = speed[:, None].expand(-1, len(asked))
    bend = curvature[:, None].expand_as(now).clamp(-ROUTE_SHARPEST, ROUTE_SHARPEST)
    x = y = turned = torch.zeros_like(now)
    step = dt / STRETCHES
    poses, controls = [], []
    for _ in range(steps * STRETCHES):
        away = (route[:, None] - torch.stack([x, y], -1)[:, :, None]).square().sum(-1)
        nearest = away.argmin(-1)
        ahead = (LOOKS_S * now).clamp(min=NEAREST) / ROUTE_SPACING_M
        point, across = _at(track, nearest, ahead).split(2, -1)
        aim = point + aside[:, None] * across
        dx, dy = aim[..., 0] - x, aim[..., 1] - y
        left = dy * turned.cos() - dx * turned.sin()
        steered = 2 * left / (dx.square() + dy.square()).clamp(min=1.0)
        steered = steered.clamp(-ROUTE_SHARPEST, ROUTE_SHARPEST)
        bend = bend + step / (step + STEERS_S) * (steered - bend)
        sharper = torch.maximum(bend.abs(), steered.abs()).clamp(min=_LEAST)
        most = torch.minimum(allowed.gather(1, nearest), ROUTE_LEANING / sharper)
        wanted = torch.minimum(pace, most.sqrt())
        pull = torch.maximum((wanted - now) / step, -slowing).clamp(max=SETTING_OFF)
        after = (now + step * pull).clamp(min=0.0)
        way = step * 0.5 * (now + after)
        turn = way * bend
        x = x + way * (turned + 0.5 * turn).cos()
        y = y + way * (turned + 0.5 * turn).sin()
        controls.append(torch.stack([(after - now) / step, bend], -1))
        now, turned = after, turned + turn
        poses.append(torch.stack([x, y, turned], -1))
    driven = torch.stack(poses[STRETCHES - 1 :: STRETCHES], -2)
    return driven, torch.stack(controls, -2).unflatten(-2, (steps, STRETCHES)).mean(-2)


def strays_from(places: Tensor, route: Tensor) -> Tensor:
    """[B, N] m from places [B, N, 2] to routes [B, P, 2], which go on straight at both ends."""
    begin, step = route[:, None, :-1], route.diff(dim=1)[:, None]
    offset = places[:, :, None] - begin
    share = (offset * step).sum(-1) / step.square().sum(-1).clamp(min=_LEAST)
    number = torch.arange(ROUTE_POINTS - 1, device=route.device)
    share = torch.where(number > 0, share.clamp(min=0.0), share)
    share = torch.where(number < ROUTE_POINTS - 2, share.clamp(max=1.0), share)
    return (offset - share[..., None] * step).square().sum(-1).amin(-1).clamp(min=1e-8).sqrt()


def follows(places: Tensor, route: Tensor) -> Tensor:
    """Return [B, N] from 0 to 1: how well trajectories that end at places [B, N, 2] follow routes
    [B, P, 2]; 1 without a route.
    """
    kept = 1 / (1 + (strays_from(places, route) / FOLLOWS).square())
    return torch.where(is_told(route)[:, None], kept, 1.0)


def _headings(route: Tensor) -> Tensor:
    """[B, P] rad, across the points to either side."""
    padded = torch.cat([route[:, :1], route, route[:, -1:]], 1)
    dx, dy = (padded[:, 2:] - padded[:, :-2]).unbind(-1)
    return torch.atan2(dy, dx)


def _allowed(heading: Tensor) -> Tensor:
    """[B, P] m²/s²: the square of the speed at points, so that no bend ahead is too fast."""
    turn = heading.diff(dim=1)
    turn = torch.atan2(turn.sin(), turn.cos()).abs()
    bend = torch.nn.functional.pad(turn, (0, 1)) / ROUTE_SPACING_M
    here = ROUTE_LEANING / bend.clamp(min=_LEAST)
    place = ROUTE_SPACING_M * torch.arange(ROUTE_POINTS, device=heading.device)
    later = place - place[:, None]
    slower = here[:, None] + 2 * EASING * later.clamp(min=0.0)
    return torch.where(later >= 0, slower, torch.inf).amin(-1)


def _at(values: Tensor, first: Tensor, ahead: Tensor) -> Tensor:
    """Return values [B, P, F] at points [B, W] ahead of the first [B, W]: [B, W, F]."""
    place = (first + ahead).clamp(max=ROUTE_POINTS - 1 - _LEAST)
    low = place.floor()
    share = (place - low)[..., None]
    at = low.long()[..., None].expand(-1, -1, values.shape[-1])
    return (1 - share) * values.gather(1, at) + share * values.gather(1, at + 1)
