"""The ode sampler: draws anchors by carrying noise along the exported vector field.

    encode    once a scene                           -> context
    modulate  once a scene, for all flow times       -> modulation [K,M]
    field     at each stage of each step             -> dx/dt [N,T,S]
    score     once, if the planner has it            -> scores [N]

A graph takes what it needs of the others by name. If the prior is a mixture, its components are a
scene's own or what encode gives, the anchors are dealt out over them in turn, and field and score
may take each anchor's own component as `prior_mean`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import OdeSpec, RefineSpec
from anchorflow_service.bundle.entries import OdeEntry, SplineEntry
from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.conditioning.cost_map import MapScene
from anchorflow_service.engine.finish import refiner_of
from anchorflow_service.engine.interfaces import (
    Array,
    Arrays,
    Check,
    ConditionedScene,
    Context,
    Graphs,
    Samples,
    missing_roles,
    names_of_each,
    unknown_names,
)
from anchorflow_service.engine.late import LatePlans
from anchorflow_service.engine.samplers.device_loop import DeviceLoop
from anchorflow_service.engine.samplers.flow import (
    PRIOR_MEAN,
    Beginning,
    FlowField,
    flow_field,
    renoised,
)
from anchorflow_service.engine.thread_pool import ThreadPool
from anchorflow_trajectory.ode.guidance import Guidance
from anchorflow_trajectory.ode.integrate import drawn, integrate
from anchorflow_trajectory.ode.schedule import remaining
from anchorflow_trajectory.scene import ROUTE_STATES

MIN_SLICE = 8  # anchors; a thread that gets fewer costs more than it saves
FIXED_SLICE = 16  # anchors, at most, if cutting changes the last digits

SCORE, SCORES = "score", "scores"
GOAL = "goal"
"""The input that says where trajectories end."""
# Inputs of each role besides the outputs of encode, and what it may take besides if the prior is a
# mixture.
OWN_INPUTS = {"modulate": ("times",), "field": ("x_t", "modulation"), SCORE: ("x_1",)}
OF_A_MIXTURE = {"modulate": (), "field": (PRIOR_MEAN,), SCORE: (PRIOR_MEAN,)}
OUTPUTS = {"modulate": "modulation", "field": "dx_t", SCORE: SCORES}


@dataclass(frozen=True)
class FlowStates:
    """Anchors on their way through the flow, before they are finished.

    times: [K] flow times of the schedule, from noise to 1
    positions: [K,N,T,D] m
    """

    times: NDArray[np.float64]
    positions: Array


class OdeSampler:
    """Samples with the graphs of an "ode" planner; several threads may sample at once.

    Anchors do not depend on each other, so they are cut into a slice a thread and each slice is
    integrated to the end on its own. One call on several threads would wait for the slowest of
    them at every node of every evaluation instead. A caller with one thread keeps the anchors in
    one piece, which takes less time in total.

    On a provider with a memory of its own they stay in one piece, and in that memory until t = 1.
    Guidance and the states on the way need the host at every step, so with them the anchors cross
    to the device and back at every evaluation.

    Raises:
        ProviderError: the provider of the device's operations is not available.
    """

    def __init__(self, manifest: Manifest, graphs: Graphs, *, threads: int) -> None:
        assert isinstance(manifest.sampler, OdeEntry)
        self._manifest, self._graphs, self._prior = manifest, graphs, manifest.sampler.prior
        self._on_device = DeviceLoop(graphs.device) if graphs.device else None
        self._is_scored = SCORE in manifest.graphs
        self._extras = [spec.name for spec in manifest.sampled_extras]
        self._of_each = names_of_each(manifest.sampled_extras)
        self._state_shape, self._late = state_shape(manifest), LatePlans(manifest)
        self._threads = threads
        self._pool = ThreadPool(threads, name="anchorflow-field")
        self.cuts_freely = False
        """Whether anchors give the same bytes in one piece and in slices, as `settle` found. If
        they do not, samples are always cut as for all threads."""

    @staticmethod
    def faults(manifest: Manifest) -> Iterator[str]:
        """Find roles that are missing, inputs that no other graph gives, and wrong states."""
        assert isinstance(manifest.sampler, OdeEntry)
        if missing := list(missing_roles(manifest, ("encode", "modulate", "field"))):
            yield from missing
            return
        graphs, prior = manifest.graphs, manifest.sampler.prior
        context = graphs["encode"].output_names
        if prior is not None:
            yield from unknown_names("sampler.prior", (prior.basis,), context)
            yield from unknown_names("sampler.prior", (prior.mean,), (*context, ROUTE_STATES))
        is_mixture = has_mixture(manifest)
        for role, own in OWN_INPUTS.items():
            if role in graphs:
                known = (*own, *(OF_A_MIXTURE[role] if is_mixture else ()), *context)
                yield from _graph_faults(manifest, role, known)
        yield from unknown_names(
            "answer.extras", [spec.name for spec in manifest.sampled_extras], context
        )
        if not isinstance(manifest.finish, SplineEntry):
            given = ("trajectories", *((SCORES,) if SCORE in graphs else ()))
            yield from unknown_names("answer.arrays", manifest.answer.arrays, given)
        steps, size = state_shape(manifest)
        least = 3 * manifest.D + 1 if isinstance(manifest.finish, SplineEntry) else manifest.D
        if steps != manifest.time.steps or not isinstance(size, int) or size < least:
            own = f"{[steps, size]} for [T,S]"
            wanted = f"{manifest.time.steps} and at least {least} numbers"
            yield f"graphs.field.inputs: x_t has {own}, expected {wanted}"

    def settle(self, scene: ConditionedScene) -> None:
        """Check the graphs, and whether anchors in slices have the same bytes as in one piece."""
        encoded = self._graphs.settle("encode", self._scene_inputs(scene))
        context = {**self._own_prior(scene), **encoded}
        most = max(self._threads, 2)  # one thread has to answer what two do
        noise = self.draw_noise(context, num_samples=MIN_SLICE * most, seed=scene.request.seed)
        begun = self.beginning(context, noise)
        if self._is_scored:
            self._graphs.settle(SCORE, _score_inputs(context, begun.x, begun.mean))
        field = flow_field(self._graphs, context, OdeSpec("euler", (0.0, 1.0)))
        whole = _evaluated(field, begun)
        self.cuts_freely = all(
            np.array_equal(
                whole, np.concatenate([_evaluated(field, part) for part in begun.cut(parts)])
            )
            for parts in range(2, most + 1)
        )

    def encode(self, scene: ConditionedScene, *, threads: int = 1) -> Context:
        """Return what the other graphs need to know of a scene, and the components of its prior."""
        inputs = self._scene_inputs(scene)
        if threads == 1 or not self._searches:
            return {**self._own_prior(scene), **self._graphs.run("encode", inputs, threads=threads)}
        # A graph releases the interpreter's lock, and so does the search for a scene's routes. The
        # graph is usually the shorter of the two: on another thread it would leave this one asleep
        # at its end, and waking takes up to a millisecond.
        tasks = (
            partial(self._graphs.run, "encode", inputs, threads=threads - 1),
            partial(self._own_prior, scene),
        )
        encoded, own = self._pool.run(tasks)
        return {**own, **encoded}

    def _scene_inputs(self, scene: ConditionedScene) -> Arrays:
        return scene.inputs(self._manifest.graphs["encode"].input_names)

    @property
    def _searches(self) -> bool:
        """Whether the prior is a mixture whose components are a scene's own."""
        return self._prior is not None and self._prior.mean == ROUTE_STATES

    def _own_prior(self, scene: ConditionedScene) -> Arrays:
        """Return the components [1,M,T,S] of that mixture; encode gives those of other priors."""
        return scene.inputs((ROUTE_STATES,)) if self._searches else {}

    def sample(
        self,
        scene: ConditionedScene,
        context: Context,
        *,
        threads: int,
        check: Check = lambda: None,
    ) -> Samples:
        """Return states [N,T,S] at t = 1."""
        begun, spec = self._begin(scene, context)
        guidance = guidance_of(self._manifest, scene, context)
        states = self.integrate(
            context, begun, spec, guidance=guidance, threads=threads, check=check
        )
        arrays = {name: context[name][0] for name in self._extras}
        # One entry for each component of the prior, which the anchors are dealt out over.
        arrays |= {name: arrays[name][begun.route] for name in self._of_each}
        if self._is_scored:
            inputs = _score_inputs(context, self._late.as_driven(states, scene), begun.mean)
            arrays[SCORES] = self._graphs.run(SCORE, inputs, threads=threads)[SCORES][0]
            check()
        return Samples(states, begun.route, arrays)

    def scorer(
        self, scene: ConditionedScene, context: Context, *, threads: int
    ) -> Callable[[Array], Array] | None:
        """Return a function that scores states [K,T,S] of a scene that were not sampled; None if
        the planner has no scores, or the request says where trajectories end."""
        if not self._is_scored or GOAL in scene.request.inputs:
            return None

        def scored(states: Array) -> Array:
            inputs = _score_inputs(context, self._late.as_driven(states, scene), states)
            return self._graphs.run(SCORE, inputs, threads=threads)[SCORES][0]

        return scored

    def flow_states(self, scene: ConditionedScene) -> FlowStates:
        """Return the states that `sample` passes through, noise and the last included."""
        context = self.encode(scene)
        begun, spec = self._begin(scene, context)
        guidance = guidance_of(self._manifest, scene, context)
        states = self.states(context, begun, spec, guidance=guidance)
        return FlowStates(np.array(spec.schedule), states[..., : self._manifest.D])

    def _begin(self, scene: ConditionedScene, context: Context) -> tuple[Beginning, OdeSpec]:
        """Return the anchors at the first time of the schedule that is left to run."""
        request, spec = scene.request, scene.request.sampler
        assert isinstance(spec, OdeSpec)
        noise = self.draw_noise(context, num_samples=request.num_samples, seed=request.seed)
        begun = self.beginning(context, noise)
        if warm := request.warm_start:
            assert isinstance(scene, MapScene)
            begun = replace(begun, x=renoised(warm, begun.x, begun.route, scene.scene))
            spec = replace(spec, schedule=remaining(spec.schedule, warm.tau))
        return begun, spec

    def draw_noise(self, context: Context, *, num_samples: int, seed: int) -> Array:
        """Draw standard normal noise: [N,R] for the planner's prior, [N,T,S] if it has none.

        A seed's first n anchors are the same for every N.
        """
        prior = self._prior
        size = context[prior.basis].shape[1:2] if prior else self._state_shape
        generator = np.random.Generator(np.random.PCG64(seed))
        return generator.standard_normal((num_samples, *size), dtype=np.float32)

    def beginning(self, context: Context, noise: Array) -> Beginning:
        """Return x_0 = prior mean + noise · prior basis; the noise itself without a prior."""
        prior, first = self._prior, np.zeros(len(noise), np.intp)
        if prior is None:
            return Beginning(noise, first, None)
        spread = drawn(noise, context[prior.basis][0]).reshape(-1, *self._state_shape)
        (components,) = context[prior.mean]
        if components.ndim == 2:
            return Beginning(components + spread, first, None)
        route = np.arange(len(noise)) % len(components)
        mean = components[route]
        return Beginning(mean + spread, route, mean)

    def integrate(
        self,
        context: Context,
        begun: Beginning,
        sampler: OdeSpec,
        *,
        guidance: Guidance | None = None,
        threads: int | None = None,
        check: Callable[[], object] = lambda: None,
    ) -> Array:
        """Return the states at t = 1 [N,T,S] of anchors at the schedule's first time.

        guidance: corrects the field of this scene
        threads: to spread over; None: all of them
        check: called after every step of every slice; an exception that it raises ends the work
        """
        field = flow_field(self._graphs, context, sampler)
        if self._on_device and guidance is None:
            return self._on_device.integrate(field, begun.x, begun.mean, on_step=check)
        threads = threads or self._threads

        def integrate_slice(part: Beginning) -> Array:
            return integrate(
                field.bound(part.mean, guidance),
                part.x,
                schedule=field.schedule,
                method=field.method,
                on_step=lambda _: check(),
            )

        # The products of guidance round a row by the number of rows beside it; with slices of a
        # fixed size these are the same on any machine.
        if self.cuts_freely and guidance is None:
            slices = begun.cut(min(threads, -(-len(begun.x) // MIN_SLICE)))
        else:
            slices = begun.cut(-(-len(begun.x) // FIXED_SLICE))
        if threads == 1 or len(slices) == 1:
            return np.concatenate([integrate_slice(part) for part in slices])
        tasks = [partial(integrate_slice, part) for part in slices]
        return np.concatenate(self._pool.run(tasks))

    def states(
        self,
        context: Context,
        begun: Beginning,
        sampler: OdeSpec,
        *,
        guidance: Guidance | None = None,
    ) -> Array:
        """Return the states at every time of the schedule [K,N,T,S], the first included."""
        visited, field = [begun.x], flow_field(self._graphs, context, sampler)
        integrate(
            field.bound(begun.mean, guidance),
            begun.x,
            schedule=field.schedule,
            method=field.method,
            on_step=lambda state: visited.append(state.copy()),
        )
        return np.stack(visited)


def guidance_of(manifest: Manifest, scene: ConditionedScene, context: Context) -> Guidance | None:
    """Return a request's guidance, by the cost and style of its finish.

    Without a prior, x_0 is standard normal in every number of a state.
    """
    spec = scene.request.refine
    if not isinstance(spec, RefineSpec) or spec.guidance == 0.0:
        return None
    assert isinstance(scene, MapScene)
    assert isinstance(manifest.sampler, OdeEntry)
    prior = manifest.sampler.prior
    size = manifest.time.steps * (3 * manifest.D + 1)
    return Guidance(
        refiner_of(manifest, scene).cost(spec),
        scene.scene.ends,
        prior_basis=context[prior.basis][0] if prior else np.eye(size, dtype=np.float32),
        scale=spec.guidance,
    )


def _evaluated(field: FlowField, begun: Beginning) -> Array:
    """Return dx/dt at the first of the field's times."""
    slope = np.empty_like(begun.x)
    field.bound(begun.mean)(begun.x, 0, slope)
    return slope


def _score_inputs(context: Context, states: Array, mean: Array | None) -> Arrays:
    """Return the score graph's inputs for states [N,T,S] at t = 1 that began on prior means."""
    own = {"x_1": states[None]} | ({} if mean is None else {PRIOR_MEAN: mean[None]})
    return {**context, **own}


def state_shape(manifest: Manifest) -> tuple[int, int]:
    """Return T and S of a flow's states, poses of D components first, as its field takes them."""
    graph = manifest.graphs["field"]
    steps, size = next(spec.shape[-2:] for spec in graph.inputs if spec.name == "x_t")
    return steps, size  # pyright: ignore[reportReturnType] - `faults` looks for letters


def has_mixture(manifest: Manifest) -> bool:
    """Return whether the prior has several means for a scene, and each anchor has its own."""
    assert isinstance(manifest.sampler, OdeEntry)
    prior = manifest.sampler.prior
    if prior is None or prior.mean == ROUTE_STATES:
        return prior is not None
    given = {spec.name: spec for spec in manifest.graphs["encode"].outputs}
    return prior.mean in given and len(given[prior.mean].shape) == 4


def _graph_faults(manifest: Manifest, role: str, known: tuple[str, ...]) -> Iterator[str]:
    graph, where = manifest.graphs[role], f"graphs.{role}.inputs"
    yield from unknown_names(where, graph.input_names, known)
    if role != SCORE:
        yield from unknown_names(where, OWN_INPUTS[role], graph.input_names)
    if graph.output_names != (OUTPUTS[role],):
        names = ", ".join(graph.output_names)
        yield f"graphs.{role}.outputs: expected {OUTPUTS[role]}, got {names}"
