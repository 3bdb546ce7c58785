"""Samples without a network, for scenes in which something moves.

The flows were trained on worlds that stand still. What they make of a way past somebody is worse
than the way itself (docs/people.md), so anchors begin on the ways in space and time.
"""

from __future__ import annotations

import numpy as np

from anchorflow_service.engine.conditioning.cost_map import MapScene
from anchorflow_service.engine.interfaces import Samples
from anchorflow_service.engine.samplers.flow import renoised


def drawn_round_ways(scene: MapScene) -> Samples:
    """Return the states of splines about the ways of a scene, by the seed of its request."""
    request, problem = scene.request, scene.scene
    rng = np.random.Generator(np.random.PCG64(request.seed))
    drawn = problem.spread_round_routes(request.num_samples, rng)
    states = problem.states_of(drawn.splines)
    if warm := request.warm_start:
        states = renoised(warm, states, drawn.route, problem)
    return Samples(states, drawn.route)
