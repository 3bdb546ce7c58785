"""Anchors beside those of a scene where few of them are safe, among what moves.

Few safe anchors squeeze through: a way over places and times that ends a little short of the goal,
or keeps more room, may be better. Where none is safe, it may be all there is.
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
from anchorflow_trajectory.routes.passing import evasions
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


def best_beside(finish: SceneFinish, refined: Refined, spec: Refinement, count: int) -> Refined:
    """Return what is best of a scene's own anchors and of others that may end short of the goal.

    Where none of these is safe, anchors step aside. Where the robot is touched, nothing is safe.
    """
    if finish.scene.is_touched:
        return refined
    found = [refined] if refined.safe.any() else [*_dodging(finish, spec, count)]
    found += islice(_in_time(finish, spec, count), 1)  # the first that is safe
    if not found:
        return _evading(finish, spec, count) or refined
    return max(found, key=lambda each: _worth(finish, each))


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


def _evading(finish: SceneFinish, spec: Refinement, count: int) -> Refined | None:
    """Return anchors that step aside from where the robot is, if one of them is safe."""
    scene, basis = finish.scene, finish.scene.basis.finer or finish.scene.basis
    cost = replace(finish.cost(spec), basis=basis)
    drawn = evasions(basis, scene.ends, scene.motion)
    safe = finish.are_safe(drawn, basis, spec.certified_margin)
    if not safe.any():
        return None
    kept = np.flatnonzero(safe)[np.argsort(cost.value(drawn[safe]), kind="stable")]
    chosen = drawn[kept[np.arange(count) % len(kept)]]
    return _short_of_goal(finish, finish.measured(chosen, cost, spec))


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
