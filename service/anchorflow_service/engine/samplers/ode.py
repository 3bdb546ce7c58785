"""The flow sampler: anchors drawn by carrying noise along the exported vector field.

    encode    once a scene                           -> context
    modulate  once a scene, for all its flow times   -> modulation [K,M]
    field     at each stage of each step             -> dx/dt [N,T,S]

What a graph needs of the others it takes by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import SamplerSpec
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.graphs import BoundGraph, open_graph
from anchorflow_service.bundle.providers import DEFAULT_PROVIDER
from anchorflow_trajectory.ode.integrate import integrate
from anchorflow_trajectory.ode.method import method_named
from anchorflow_trajectory.ode.schedule import stage_times

Array = NDArray[np.float32]
Context = Mapping[str, Array]

MIN_SLICE = 8  # anchors; a thread that gets fewer costs more than it brings


@dataclass(frozen=True)
class FlowStates:
    """Anchors on their way through the flow, before they are finished.

    times: [K] flow times of the schedule, from noise to 1
    positions: [K,N,T,D] m
    """

    times: NDArray[np.float64]
    positions: Array


class FlowSampler:
    """The graphs of an "ode" bundle, opened; several threads may sample at once.

    The anchors do not look at each other, so they are cut into a slice a thread and each slice is
    integrated to the end on its own. One call on several threads would wait for the slowest of
    them at every node of every evaluation instead. A caller who has one thread leaves the anchors
    in one piece, which takes less time in all.

    Raises:
        BundleError: a graph cannot be opened or its signature is not the manifest's.
        ProviderError: the provider is not to be had.
    """

    def __init__(self, bundle: Bundle, *, threads: int, provider: str = DEFAULT_PROVIDER) -> None:
        self._manifest = bundle.manifest
        self._encode = open_graph(bundle, "encode", provider=provider)
        self._encode_wide = (
            open_graph(bundle, "encode", threads=threads, provider=provider)
            if threads > 1
            else self._encode
        )
        self._modulate = open_graph(bundle, "modulate", provider=provider)
        self._field = open_graph(bundle, "field", provider=provider)
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="anchorflow-field")
        self._cuts_freely = False

    def settle(self, inputs: Mapping[str, Array], *, seed: int) -> bool:
        """Look whether these graphs give the same bytes on one thread and on many, in one piece
        and in slices; the answer is kept.

        Where they do not, which a machine's kernels decide, samples are always cut as for all
        threads and encoded on one, so that no answer depends on how busy the service is.
        """
        narrow, wide = self._encode(**inputs), self._encode_wide(**inputs)
        noise = self.draw_noise(narrow, num_samples=MIN_SLICE * self._threads, seed=seed)
        x = self.initial_state(narrow, noise)
        field = self._field_over(narrow, SamplerSpec("euler", (0.0, 1.0)))
        whole = _evaluated(field(), x)
        cuts = [np.array_split(x, parts) for parts in range(2, self._threads + 1)]
        self._cuts_freely = all(
            np.array_equal(narrow[name], wide[name]) for name in narrow
        ) and all(
            np.array_equal(whole, np.concatenate([_evaluated(field(), part) for part in cut]))
            for cut in cuts
        )
        return self._cuts_freely

    def encode(self, inputs: Mapping[str, Array], *, threads: int = 1) -> Context:
        """What the other graphs need to know of a scene."""
        wide = threads > 1 and self._cuts_freely
        return (self._encode_wide if wide else self._encode)(**inputs)

    def draw_noise(self, context: Context, *, num_samples: int, seed: int) -> Array:
        """Standard normal noise: [N,R] for the bundle's prior, [N,T,S] where it has none.

        A seed's first n anchors are the same whatever N is.
        """
        prior = self._manifest.sampler.prior
        size = context[prior.basis].shape[1:2] if prior else self._state_shape
        generator = np.random.Generator(np.random.PCG64(seed))
        return generator.standard_normal((num_samples, *size), dtype=np.float32)

    def initial_state(self, context: Context, noise: Array) -> Array:
        """x_0 [N,T,S] = prior mean + noise · prior basis; the noise itself without a prior."""
        prior = self._manifest.sampler.prior
        if prior is None:
            return noise
        spread = (noise @ context[prior.basis][0]).reshape(-1, *self._state_shape)
        return context[prior.mean] + spread

    def integrate(
        self,
        context: Context,
        x: Array,
        sampler: SamplerSpec,
        *,
        threads: int | None = None,
        check: Callable[[], object] = lambda: None,
    ) -> Array:
        """The state at t = 1 [N,T,S] from x at the schedule's first time.

        threads: to spread over; None: all of them
        check: called after every step of every slice; what it raises ends the work and is raised
        """
        schedule, method = sampler.schedule, method_named(sampler.method)
        new_field = self._field_over(context, sampler)
        threads = threads or self._threads

        def integrate_slice(part: Array) -> Array:
            return integrate(
                new_field(), part, schedule=schedule, method=method, on_step=lambda _: check()
            )

        most = threads if self._cuts_freely else self._threads
        slices = np.array_split(x, min(most, -(-len(x) // MIN_SLICE)))
        if threads == 1 or len(slices) == 1:
            return np.concatenate([integrate_slice(part) for part in slices])
        running = [self._pool.submit(integrate_slice, part) for part in slices]
        wait(running)  # all of them: one that is left behind would keep a core busy unseen
        return np.concatenate([part.result() for part in running])

    def states(self, context: Context, x: Array, sampler: SamplerSpec) -> Array:
        """The states at every time of the schedule [K,N,T,S]; x is the first of them."""
        visited = [x]
        integrate(
            self._field_over(context, sampler)(),
            x,
            schedule=sampler.schedule,
            method=method_named(sampler.method),
            on_step=lambda state: visited.append(state.copy()),
        )
        return np.stack(visited)

    def _field_over(self, context: Context, sampler: SamplerSpec) -> Callable[[], _ModulatedField]:
        """Makes the vector field of a scene at the sampler's times, one for each thread."""
        times = stage_times(method_named(sampler.method), sampler.schedule).times
        modulate_inputs = self._modulate.select({**context, "times": times})
        modulation = self._modulate(**modulate_inputs)["modulation"]
        field_inputs = self._field.select(context)
        return lambda: _ModulatedField(self._field.bind(**field_inputs), modulation)

    @property
    def _state_shape(self) -> tuple[int, int]:
        return self._manifest.T, self._manifest.state_size


class _ModulatedField:
    """The bound field graph as the solver's vector field.

    modulation: [1,K,M], one row for each distinct stage time
    """

    def __init__(self, field: BoundGraph, modulation: Array) -> None:
        self._field = field
        self._modulation = modulation

    def __call__(self, x: Array, time_index: int, out: Array) -> None:
        self._field(
            {"x_t": x[None], "modulation": self._modulation[:, time_index]},
            outputs={"dx_t": out[None]},
        )


def _evaluated(field: _ModulatedField, x: Array) -> Array:
    """dx/dt at the first of the field's times."""
    slope = np.empty_like(x)
    field(x, 0, slope)
    return slope
