"""The ode sampler: anchors drawn by carrying noise along the exported vector field.

    encode    once a scene                           -> context
    modulate  once a scene, for all its flow times   -> modulation [K,M]
    field     at each stage of each step             -> dx/dt [N,T,S]
    score     once, where a bundle has it            -> scores [N]

What a graph needs of the others it takes by name. Where the prior is a mixture, its components
are a scene's own or what encode gives, the anchors are dealt out over them in turn, and the field
may ask for each anchor's own as `prior_mean`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import OdeSpec
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.device import DEVICES
from anchorflow_service.bundle.graphs import WideGraph
from anchorflow_service.bundle.manifest import Manifest, OdeEntry
from anchorflow_service.bundle.providers import DEFAULT_PROVIDER
from anchorflow_service.engine.conditioning.cost_map import MapScene
from anchorflow_service.engine.parts import (
    Check,
    ConditionedScene,
    Context,
    Samples,
)
from anchorflow_service.engine.samplers.device_loop import DeviceLoop
from anchorflow_service.engine.samplers.flow_field import FieldGraphs, FlowField
from anchorflow_service.engine.samplers.flow_score import ROLE, FlowScore
from anchorflow_service.engine.samplers.guided import guidance_of, guided
from anchorflow_service.engine.samplers.ode_faults import ode_faults, state_shape
from anchorflow_service.engine.samplers.warm_start import renoised
from anchorflow_service.engine.side_by_side import Helpers
from anchorflow_trajectory.ode.guidance import Guidance
from anchorflow_trajectory.ode.integrate import drawn, integrate
from anchorflow_trajectory.ode.schedule import remaining
from anchorflow_trajectory.scene import ROUTE_STATES

Array = NDArray[np.float32]

MIN_SLICE = 8  # anchors; a thread that gets fewer costs more than it brings
FIXED_SLICE = 16  # anchors, at most, where a cut changes the last digits


@dataclass(frozen=True, eq=False)
class Beginning:
    """N anchors before the flow.

    x: [N,T,S]; route: [N] the component of the prior that each began on
    mean: [N,T,S], that component; None where the prior has none
    """

    x: Array
    route: NDArray[np.intp]
    mean: Array | None


@dataclass(frozen=True)
class FlowStates:
    """Anchors on their way through the flow, before they are finished.

    times: [K] flow times of the schedule, from noise to 1
    positions: [K,N,T,D] m
    """

    times: NDArray[np.float64]
    positions: Array


class OdeSampler:
    """The graphs of an "ode" bundle, opened; several threads may sample at once.

    The anchors do not look at each other, so they are cut into a slice a thread and each slice is
    integrated to the end on its own. One call on several threads would wait for the slowest of
    them at every node of every evaluation instead. A caller who has one thread leaves the anchors
    in one piece, which takes less time in all.

    On a provider with a memory of its own they stay in one piece, and in that memory until t = 1.
    Guidance and the states on the way need the host at every step, so with them the anchors are
    integrated there, on such a provider too, and cross to it and back at every evaluation.

    Raises:
        BundleError: a graph cannot be opened or its signature is not the manifest's.
        ProviderError: the provider is not to be had.
    """

    def __init__(self, bundle: Bundle, *, threads: int, provider: str = DEFAULT_PROVIDER) -> None:
        self._manifest = bundle.manifest
        assert isinstance(bundle.manifest.sampler, OdeEntry)
        self._prior = bundle.manifest.sampler.prior
        self._encode = WideGraph(bundle, "encode", threads=threads, provider=provider)
        self._fields = FieldGraphs(bundle, provider=provider)
        self._on_device = DeviceLoop(DEVICES[provider]) if provider in DEVICES else None
        self._score = (
            FlowScore(bundle, threads=threads, provider=provider)
            if ROLE in bundle.manifest.graphs
            else None
        )
        self._extras = [spec.name for spec in bundle.manifest.answer.extras]
        self._state_shape = state_shape(bundle.manifest)
        self._threads = threads
        self._helpers = Helpers(threads, name="anchorflow-field")
        self.cuts_freely = False
        """Whether anchors give the same bytes in one piece and in slices, as `settle` found out.
        Where they do not, samples are always cut as for all threads."""

    @staticmethod
    def faults(manifest: Manifest) -> Iterator[str]:
        """What its manifest lacks: see `ode_faults`."""
        return ode_faults(manifest)

    def settle(self, scene: ConditionedScene) -> None:
        """Look whether these graphs give the same bytes on one thread and on many, in one piece
        and in slices, which a machine's kernels decide; so no answer depends on how busy the
        service is.
        """
        encoded = self._encode.settle(scene.inputs(self._encode.input_names))
        context = {**self._own_prior(scene), **encoded}
        most = max(self._threads, 2)  # one thread shall answer what two do
        noise = self.draw_noise(context, num_samples=MIN_SLICE * most, seed=scene.request.seed)
        begun = self.beginning(context, noise)
        if self._score:
            self._score.settle(context, begun.x, begun.mean)
        field = self._fields.over(context, OdeSpec("euler", (0.0, 1.0)))
        whole = _evaluated(field, begun)
        self.cuts_freely = all(
            np.array_equal(
                whole,
                np.concatenate([_evaluated(field, part) for part in _cut(begun, parts)]),
            )
            for parts in range(2, most + 1)
        )

    def encode(self, scene: ConditionedScene, *, threads: int = 1) -> Context:
        """What the other graphs need to know of a scene, and the components of its prior."""
        inputs = scene.inputs(self._encode.input_names)
        if threads == 1 or not self._searches:
            return {**self._own_prior(scene), **self._encode(inputs, threads=threads)}
        # A graph lets go of the interpreter's lock, and so does the search for a scene's routes. It
        # is the shorter of the two as a rule: were the graph left to another thread, this one would
        # have gone to sleep by its end, and took up to a millisecond to wake.
        tasks = (
            partial(self._encode, inputs, threads=threads - 1),
            partial(self._own_prior, scene),
        )
        encoded, own = self._helpers.side_by_side(tasks)
        return {**own, **encoded}

    @property
    def _searches(self) -> bool:
        """Whether the prior is a mixture whose components are a scene's own."""
        return self._prior is not None and self._prior.mean == ROUTE_STATES

    def _own_prior(self, scene: ConditionedScene) -> Context:
        """The components [1,M,T,S] of such a mixture; of another prior, encode gives them."""
        return scene.inputs((ROUTE_STATES,)) if self._searches else {}

    def sample(
        self,
        scene: ConditionedScene,
        context: Context,
        *,
        threads: int,
        check: Check = lambda: None,
    ) -> Samples:
        """States [N,T,S] at t = 1."""
        begun, spec = self._begin(scene, context)
        guidance = guidance_of(self._manifest, scene, context)
        states = self.integrate(
            context, begun, spec, guidance=guidance, threads=threads, check=check
        )
        arrays = {name: context[name][0] for name in self._extras}
        if self._score:
            arrays["scores"] = self._score(context, states, begun.mean, threads=threads)
            check()
        return Samples(states, begun.route, arrays)

    def flow_states(self, scene: ConditionedScene) -> FlowStates:
        """The states that `sample` passes through, noise and the last included."""
        context = self.encode(scene)
        begun, spec = self._begin(scene, context)
        guidance = guidance_of(self._manifest, scene, context)
        states = self.states(context, begun, spec, guidance=guidance)
        return FlowStates(np.array(spec.schedule), states[..., : self._manifest.D])

    def _begin(self, scene: ConditionedScene, context: Context) -> tuple[Beginning, OdeSpec]:
        """The anchors at the first time of the schedule that is left to run."""
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
        """Standard normal noise: [N,R] for the bundle's prior, [N,T,S] where it has none.

        A seed's first n anchors are the same whatever N is.
        """
        prior = self._prior
        size = context[prior.basis].shape[1:2] if prior else self._state_shape
        generator = np.random.Generator(np.random.PCG64(seed))
        return generator.standard_normal((num_samples, *size), dtype=np.float32)

    def beginning(self, context: Context, noise: Array) -> Beginning:
        """x_0 = prior mean + noise · prior basis; the noise itself without a prior."""
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
        """The states at t = 1 [N,T,S] of anchors at the schedule's first time.

        guidance: what corrects the field of this scene
        threads: to spread over; None: all of them
        check: called after every step of every slice; what it raises ends the work and is raised
        """
        field = self._fields.over(context, sampler)
        if self._on_device and guidance is None:
            return self._on_device.integrate(field, begun.x, begun.mean, on_step=check)
        threads = threads or self._threads

        def integrate_slice(part: Beginning) -> Array:
            return integrate(
                guided(field, part.mean, guidance),
                part.x,
                schedule=field.schedule,
                method=field.method,
                on_step=lambda _: check(),
            )

        # The products of guidance round a row by the number of rows beside it: on any machine these
        # are the same.
        if self.cuts_freely and guidance is None:
            slices = _cut(begun, min(threads, -(-len(begun.x) // MIN_SLICE)))
        else:
            slices = _cut(begun, -(-len(begun.x) // FIXED_SLICE))
        if threads == 1 or len(slices) == 1:
            return np.concatenate([integrate_slice(part) for part in slices])
        tasks = [partial(integrate_slice, part) for part in slices]
        return np.concatenate(self._helpers.side_by_side(tasks))

    def states(
        self,
        context: Context,
        begun: Beginning,
        sampler: OdeSpec,
        *,
        guidance: Guidance | None = None,
    ) -> Array:
        """The states at every time of the schedule [K,N,T,S]; the first are those begun with."""
        visited, field = [begun.x], self._fields.over(context, sampler)
        integrate(
            guided(field, begun.mean, guidance),
            begun.x,
            schedule=field.schedule,
            method=field.method,
            on_step=lambda state: visited.append(state.copy()),
        )
        return np.stack(visited)


def _cut(begun: Beginning, parts: int) -> list[Beginning]:
    """The anchors in parts of about the same size."""
    count = len(begun.x)
    bounds = [count * part // parts for part in range(parts + 1)]
    return [
        Beginning(
            begun.x[begin:end],
            begun.route[begin:end],
            None if begun.mean is None else begun.mean[begin:end],
        )
        for begin, end in pairwise(bounds)
    ]


def _evaluated(field: FlowField, begun: Beginning) -> Array:
    """dx/dt at the first of the field's times."""
    slope = np.empty_like(begun.x)
    field.bound(begun.mean)(begun.x, 0, slope)
    return slope
