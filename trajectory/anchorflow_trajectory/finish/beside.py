"""Anchors beside those of a scene where few of them are safe, or the best is a close call.

Few safe anchors squeeze through, and who passes somebody by a hand's breadth collides if that
person turns a little: a way over places and times that ends a little short of the goal, or an
evasive manoeuvre, may be better. Where none is safe, they may be all there is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.ending import in_time
from anchorflow_trajectory.finish.optimisation_pass import OptimisationPass
from anchorflow_trajectory.finish.refined import Refined, Refinement
from anchorflow_trajectory.finish.scene_finish import SceneFinish
from anchorflow_trajectory.movers import Discs
from anchorflow_trajectory.routes.evasions import evasions
from anchorflow_trajectory.scene import CLOSE, HURRY
from anchorflow_trajectory.spline.basis import Splines

FEW = 0.1  # share of safe anchors, below which others are looked for
STIFFER = 4.0  # factor on the weights of obstacles and limits from one pass to the next
DODGE = OptimisationPass(60, 0.1, slowed_after=True)
DODGES, TIMED = 2, 8  # such passes until one is safe, over so many ways over places and times
CARES = ((HURRY, CLOSE), (0.8, 0.1), (0.6, 0.2))
"""Shares of v_max that ways over places and times reach, and m that they keep from what moves."""
SHORT = 10.0  # cost of an end elsewhere, a way that v_max covers in the reference time off
RATHER = 9.0  # times that cost more is borne for anchors that end at the goal
SOON_S, NEAR = 1.5, 0.2  # s ahead, and m from what moves that are a close call
NEARER = 0.05  # m by which it comes nearer than it is, or there is nothing to evade
CALL = 40.0  # cost of touching soon


def is_close_call(finish: SceneFinish, refined: Refined) -> bool:
    """Return whether the best anchor lets what moves come near soon."""
    best = int(np.where(refined.safe, refined.scores, -np.inf).argmax())
    now, least = _gaps(finish, refined, slice(best, best + 1))
    return bool(least[0] < min(NEAR, now[0] - NEARER))


def best_beside(finish: SceneFinish, refined: Refined, spec: Refinement, count: int) -> Refined:
    """Return what is best of a scene's own anchors and of others that may end short of the goal.

    Where all of these are close calls or none is safe, anchors may evade. Where the robot is
    touched, nothing is safe.
    """
    if finish.scene.is_touched:
        return refined
    found = [refined] if refined.safe.any() else [*_dodging(finish, spec, count)]
    found += islice(_in_time(finish, spec, count), 1)  # the first that is safe
    if all(is_close_call(finish, each) for each in found):
        found += _evading(finish, spec, count)
    found = [_wary(finish, each) for each in found]
    return max(found, key=lambda each: _worth(finish, each), default=refined)


def _dodging(finish: SceneFinish, spec: Refinement, count: int) -> Iterator[Refined]:
    """Yield anchors along other ways past what moves, if one of them is safe."""
    others = finish.scene.ways.others
    assert others is not None
    yield from _along(finish, finish, others[:count], spec, count, passes=1)


def _in_time(finish: SceneFinish, spec: Refinement, count: int) -> Iterator[Refined]:
    """Yield anchors along the cheapest ways over places and times, the most hurried first."""
    for care in CARES:
        if (timed := in_time(finish.scene, *care)) is not None:
            scene, ways = timed
            nearer = replace(finish, scene=scene)
            yield from _along(finish, nearer, ways[:TIMED], spec, count, passes=DODGES)


def _along(
    asked: SceneFinish,
    nearer: SceneFinish,
    drawn: Splines,
    spec: Refinement,
    count: int,
    *,
    passes: int,
) -> Iterator[Refined]:
    """Yield `count` anchors along ways that are drawn, if one of them is safe.

    asked: finishes the scene whose goal and cost the scores tell
    nearer: finishes the scene in which the ways end, maybe short of that goal
    passes: how many are tried until one is safe; each is stiffer than the last
    """
    cost, finer = nearer.cost(spec), nearer.scene.basis.finer
    if finer is not None:
        drawn, cost = nearer.scene.basis.refined(drawn), replace(cost, basis=finer)
    for _ in range(passes):
        cost = replace(cost, weights=cost.weights.stiffer(STIFFER))
        drawn, safe = nearer.optimised(DODGE, cost, drawn, spec.certified_margin, None)
        if safe.any():
            moved = nearer.bisected(drawn, safe, cost, spec.certified_margin)
            copies = moved[np.arange(count) % len(moved)]
            measure = replace(asked.cost(spec), basis=cost.basis)
            yield _short_of_goal(asked, nearer.measured(copies, measure, spec))
            return


def _evading(finish: SceneFinish, spec: Refinement, count: int) -> Iterator[Refined]:
    """Yield evasive manoeuvres from where the robot is, if one of them is safe."""
    scene, basis = finish.scene, finish.scene.basis.finer or finish.scene.basis
    cost = replace(finish.cost(spec), basis=basis)
    drawn = evasions(basis, scene.ends, scene.motion)
    safe = finish.are_safe(drawn, basis, spec.certified_margin)
    if safe.any():
        kept = np.flatnonzero(safe)[np.argsort(cost.value(drawn[safe]), kind="stable")]
        chosen = drawn[kept[np.arange(count) % len(kept)]]
        yield _short_of_goal(finish, finish.measured(chosen, cost, spec))


def _worth(finish: SceneFinish, refined: Refined) -> float:
    """Return the best score of what is safe, for which an end short of the goal costs more."""
    worth = refined.scores - RATHER * _shortness(finish, refined)
    return float(worth[refined.safe].max())


def _short_of_goal(finish: SceneFinish, refined: Refined) -> Refined:
    """Return anchors with scores that tell how far from the goal they end."""
    scores = refined.scores - _shortness(finish, refined)
    return replace(refined, scores=scores.astype(refined.scores.dtype))


def _shortness(finish: SceneFinish, refined: Refined) -> FloatArray:
    """Return what it costs [N] to end where anchors do and not at the goal."""
    scene = finish.scene
    short = np.linalg.norm(refined.positions[:, -1, :2] - scene.x_goal[:2], axis=-1)
    return SHORT * short / (scene.motion.v_max * scene.reference_s)


def _wary(finish: SceneFinish, refined: Refined) -> Refined:
    """Return anchors with scores that tell how near they let what moves come soon."""
    _, least = _gaps(finish, refined)
    lack = np.maximum(1.0 - least / NEAR, 0.0)
    return replace(refined, scores=(refined.scores - CALL * lack**2).astype(refined.scores.dtype))


def _gaps(
    finish: SceneFinish, refined: Refined, which: slice = slice(None)
) -> tuple[FloatArray, FloatArray]:
    """Return m from anchors [N] to what moves, now and at the least within SOON_S."""
    movers = finish.scene.cost_fields.movers
    assert movers is not None
    paths, lasting = refined.positions[which, :, :2], refined.duration[which]
    times = np.linspace(0.0, 1.0, paths.shape[1]) * lasting[:, None]
    soon = (times <= SOON_S).any(0)
    paths, times = paths[:, soon], times[:, soon]
    now = least = np.full(len(paths), np.inf)
    discs = Discs.of(movers, np.float64)
    leg = np.minimum((times / movers.step_s).astype(int), discs.lines.shape[1] - 1)
    for line, radius in zip(discs.lines, discs.radius, strict=True):
        at = line[leg]
        apart = np.linalg.norm(paths - at[..., :2] - at[..., 2:] * times[..., None], axis=-1)
        gap = apart - radius - movers.growth * times
        now = np.minimum(now, gap[:, 0])
        least = np.minimum(least, np.where(times <= SOON_S, gap, np.inf).min(1))
    return now, least
