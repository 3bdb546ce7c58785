"""The flow of a scene: its vector field at the times of a method, and where anchors begin.

    modulate  once a scene, for all flow times   -> modulation [K,M]
    field     at each stage of each step         -> dx/dt [N,T,S]

The graphs may be a bundle's or a network's; states are numpy arrays either way, [N,T,S] for one
scene or [B,N,T,S] for several.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import OdeSpec, WarmStart
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.engine.conditioning.cost_map import MapScene
from anchorflow_service.engine.interfaces import Arrays, BoundGraph, Context, Graphs, Samples
from anchorflow_trajectory.ode.integrate import VectorField
from anchorflow_trajectory.ode.methods import Method, method_named
from anchorflow_trajectory.ode.schedule import Schedule, stage_strides, stage_times
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.warm_start import warm_states, whole_fields

Array = NDArray[np.float32]

PRIOR_MEAN = "prior_mean"


@dataclass(frozen=True, eq=False)
class Beginning:
    """N anchors before the flow.

    x: [N,T,S]; route: [N] the component of the prior that each began on
    mean: [N,T,S], that component; None if the prior has none
    """

    x: Array
    route: NDArray[np.intp]
    mean: Array | None

    def cut(self, parts: int) -> list[Beginning]:
        """Cut the anchors into parts of about the same size."""
        count = len(self.x)
        bounds = [count * part // parts for part in range(parts + 1)]
        return [
            Beginning(
                self.x[begin:end],
                self.route[begin:end],
                None if self.mean is None else self.mean[begin:end],
            )
            for begin, end in pairwise(bounds)
        ]


class Correction(Protocol):
    """Changes a field while anchors are drawn, such as guidance or a control barrier."""

    def correct(self, field: Array, x_t: Array, t: float, *, stride: float) -> None:
        """Correct in place the field at x_t and flow time t, in a solver's step of that stride."""


@dataclass(frozen=True, eq=False)
class FlowField:
    """The field graph with everything that a scene gives it.

    context: its inputs that are the same for all anchors and times
    modulation: [B,K,M], one row for each distinct stage time of the method on the schedule
    """

    graphs: Graphs
    context: Arrays
    modulation: Array
    method: Method
    schedule: Schedule

    @property
    def times(self) -> Array:
        """The distinct stage times [K]."""
        return stage_times(self.method, self.schedule).times

    def fixed(self, mean: Array | None) -> Arrays:
        """Return the inputs that stay the same along the way of anchors that began on means."""
        own = {} if mean is None else {PRIOR_MEAN: with_scenes(mean)}
        return self.graphs.select("field", {**self.context, **own})

    def bound(self, mean: Array | None, correction: Correction | None = None) -> VectorField:
        """Return the vector field of anchors that began on means; each thread needs its own."""
        bound = _ModulatedField(self.graphs.bind("field", self.fixed(mean)), self.modulation)
        if correction is None:
            return bound
        return _CorrectedField(
            bound, correction, self.times, stage_strides(self.method, self.schedule)
        )


def flow_field(graphs: Graphs, context: Context, sampler: OdeSpec) -> FlowField:
    """Return the field of a scene at the stage times of a sampler."""
    method, schedule = method_named(sampler.method), sampler.schedule
    times = stage_times(method, schedule).times
    modulation = graphs.run("modulate", {**context, "times": times})["modulation"]
    return FlowField(graphs, graphs.select("field", context), modulation, method, schedule)


@dataclass(frozen=True, eq=False)
class _ModulatedField:
    """The bound field graph as the solver's vector field; modulation: [B,K,M]."""

    graph: BoundGraph
    modulation: Array

    def __call__(self, x: Array, time_index: int, out: Array) -> None:
        self.graph(
            {"x_t": with_scenes(x), "modulation": self.modulation[:, time_index]},
            outputs={"dx_t": with_scenes(out)},
        )


@dataclass(frozen=True, eq=False)
class _CorrectedField:
    """A vector field and its correction.

    times, strides: [K], each stage time, and the length of the step that evaluates there
    """

    field: VectorField
    correction: Correction
    times: Array
    strides: tuple[float, ...]

    def __call__(self, x: Array, time_index: int, out: Array) -> None:
        self.field(x, time_index, out)
        t, stride = float(self.times[time_index]), self.strides[time_index]
        self.correction.correct(out, x, t, stride=stride)


def with_scenes(states: Array) -> Array:
    """Return states [N,T,S] of one scene as [1,N,T,S]; those of several as they are."""
    return states if states.ndim == 4 else states[None]


def renoised(warm_start: WarmStart, x_0: Array, route: NDArray[np.intp], scene: Scene) -> Array:
    """Return x_tau = tau x_1 + (1 - tau) x_0, [N,T,S]; x_1 is the trajectory on its own route.

    Raises:
        InvalidRequest: its columns are not whole positions, velocities and accelerations.
    """
    trajectory, dim = warm_start.trajectory, len(scene.x_goal) // 2
    columns = trajectory.shape[1]
    if not whole_fields(columns, dim):
        widths = ", ".join(str(dim * blocks) for blocks in (1, 2, 3))
        raise InvalidRequest(
            f"expected [T,{dim}] of positions, with velocities or with accelerations too "
            f"({widths} columns), got {columns} columns",
            "warm_start.trajectory",
        )
    x_1 = warm_states(scene, trajectory, route, dt=warm_start.dt)
    return np.float32(warm_start.tau) * x_1 + np.float32(1.0 - warm_start.tau) * x_0


def drawn_round_ways(scene: MapScene) -> Samples:
    """Return the states of splines about the ways of a scene, without a network.

    The flows were trained on worlds that stand still. What they make of a way past somebody is
    worse than the way itself (docs/people.md).
    """
    request, problem = scene.request, scene.scene
    rng = np.random.Generator(np.random.PCG64(request.seed))
    drawn = problem.spread_round_routes(request.num_samples, rng)
    states = problem.states_of(drawn.splines)
    if warm := request.warm_start:
        states = renoised(warm, states, drawn.route, problem)
    return Samples(states, drawn.route)
