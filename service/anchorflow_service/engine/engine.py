"""The engine: a request in, anchors out. It knows roles of graphs, not planners."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from anchorflow_client.contract import (
    AnchorBatch,
    AnchorRequest,
    ModelCard,
    ResolvedRequest,
    SamplerSpec,
    resolve_for_card,
)
from anchorflow_client.errors import InvalidRequest, UnknownModel
from anchorflow_service.bundle import Bundle, BundleError
from anchorflow_service.bundle.providers import DEFAULT_PROVIDER
from anchorflow_service.cores import usable_cores
from anchorflow_service.engine.conditioning.cost_map import Scene, scenes_of
from anchorflow_service.engine.probe import probe_request
from anchorflow_service.engine.samplers.ode import Array, Context, FlowSampler, FlowStates
from anchorflow_service.engine.samplers.warm_start import renoised, warm_state
from anchorflow_service.engine.timing import StageClock
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.ode.schedule import remaining
from anchorflow_trajectory.refine import Refined, Refiner

Check = Callable[[], object]
"""Called between the steps of a request; what it raises ends the request."""

PROBED = 16  # anchors


class Engine:
    """A bundle, ready to plan; blocking, and safe to call from several threads.

    It has planned once when it is made: what is broken is found there, and not by a caller.

    threads: that one request may keep busy; None: the cores that this process may use
    provider: where the graphs run: "cpu", "cuda", "tensorrt" or "openvino"

    Raises:
        BundleError: a graph of the bundle cannot be opened or is not what the manifest says, or
            the bundle fails at its first request.
        ProviderError: the provider is not to be had; nothing falls back in silence.
    """

    def __init__(
        self, bundle: Bundle, *, threads: int | None = None, provider: str = DEFAULT_PROVIDER
    ) -> None:
        self.card: ModelCard = bundle.card
        self._manifest = bundle.manifest
        self._threads = threads or usable_cores()
        self._flow = FlowSampler(bundle, threads=self._threads, provider=provider)
        self._warm_up(bundle)

    def plan(
        self, request: AnchorRequest, *, threads: int | None = None, check: Check = lambda: None
    ) -> AnchorBatch:
        """Draw and finish anchors for every scene of a request.

        Scenes are planned one after the other from the same noise, so that an answer is the same
        to the last bit, alone or in a batch, and on however many threads.

        Args:
            request: what to plan.
            threads: to keep busy; None: all of the engine's.
            check: called before every stage and after every step of the solver.

        Raises:
            InvalidRequest: the request asks what this bundle or this version cannot do.
            UnknownModel: it asks for another model.
            Exception: what `check` raises.
        """
        threads = threads or self._threads
        clock = StageClock()
        with clock.stage("total"):
            resolved = resolve_for_card(request, self.card)
            self._check_supported(resolved)
            scenes = scenes_of(resolved, self.card)
            finished = [self._plan_scene(scene, clock, threads, check) for scene in scenes]
        return AnchorBatch(
            **_stacked(finished, batched=resolved.batched),
            dt=resolved.horizon_s / (self.card.T - 1),
            seed=resolved.seed,
            model=self.card.id,
            timing_ms=clock.elapsed_ms,
            request_id=resolved.request_id,
        )

    def flow_states(self, request: AnchorRequest) -> FlowStates:
        """The states that `plan` passes through on its way to the first scene's anchors.

        The last of them is what refinement starts from.

        Raises:
            InvalidRequest, UnknownModel: as `plan`.
        """
        resolved = resolve_for_card(request, self.card)
        self._check_supported(resolved)
        scene = scenes_of(resolved, self.card)[0]
        context = self._flow.encode(scene.inputs(self._manifest.inputs))
        x, sampler = self._begin(scene.request, context)
        states = self._flow.states(context, x, sampler)
        return FlowStates(np.array(sampler.schedule), states[..., : self.card.D])

    def _check_supported(self, request: ResolvedRequest) -> None:
        if request.model != self.card.name:
            raise UnknownModel(f"expected {self.card.name}, got {request.model}", "model")
        if request.refine.guidance > 0.0:
            raise InvalidRequest(
                f"expected 0, got {request.refine.guidance:g}: "
                "guidance is not supported by this version",
                "refine.guidance",
            )

    def _warm_up(self, bundle: Bundle) -> None:
        """Plan once. Raises `BundleError` where that fails or gives nonsense."""
        probe = probe_request(self.card, num_samples=PROBED)
        try:
            scene = scenes_of(probe, self.card)[0]
            self._flow.settle(scene.inputs(self._manifest.inputs), seed=probe.seed)
            batch = self.plan(probe)
        except Exception as error:  # onnxruntime's exceptions share no public base
            raise BundleError(bundle.path, "the warm-up failed", str(error)) from error
        if not batch.is_finite:
            raise BundleError(bundle.path, "the warm-up gave numbers that are not finite")

    def _plan_scene(self, scene: Scene, clock: StageClock, threads: int, check: Check) -> Refined:
        check()
        with clock.stage("encode"):
            inputs = scene.inputs(self._manifest.inputs)
            context = self._flow.encode(inputs, threads=threads)
        check()
        with clock.stage("sample"):
            x, sampler = self._begin(scene.request, context)
            state = self._flow.integrate(context, x, sampler, threads=threads, check=check)
        with clock.stage("refine"):
            return self._refine(scene, state)

    def _begin(self, request: ResolvedRequest, context: Context) -> tuple[Array, SamplerSpec]:
        """States [N,T,S] at the first time of the sampler that is left to run."""
        flow, sampler = self._flow, request.sampler
        noise = flow.draw_noise(context, num_samples=request.num_samples, seed=request.seed)
        x = flow.initial_state(context, noise)
        if warm := request.warm_start:
            x_1 = warm_state(warm, card=self.card, horizon_s=request.horizon_s)
            x = renoised(x_1, x, warm.tau)
            sampler = replace(sampler, schedule=remaining(sampler.schedule, warm.tau))
        return x, sampler

    def _refine(self, scene: Scene, state: Array) -> Refined:
        """Anchors that meet both ends, and what they are worth."""
        request, refine = scene.request, self._manifest.refine
        limits = MotionLimits(v_max=request.v_max, a_max=request.a_max, horizon_s=request.horizon_s)
        refiner = Refiner.of(
            limits,
            num_steps=self.card.T,
            num_control_points=refine.num_control_points,
            degree=refine.degree,
            steps=refine.steps,
        )
        return refiner.refine(
            state,
            scene.cost_fields,
            x_curr=scene.x_curr,
            x_goal=scene.x_goal,
            w_style=scene.w_style,
            spec=request.refine,
        )


def _stacked(scenes: Sequence[Refined], *, batched: bool) -> dict[str, np.ndarray]:
    """The arrays of an answer: those of the scenes on a B axis, or of the only one without."""
    columns = {
        "trajectories": [scene.positions for scene in scenes],
        "velocities": [scene.velocities for scene in scenes],
        "accelerations": [scene.accelerations for scene in scenes],
        "scores": [scene.scores for scene in scenes],
        "clearance": [scene.clearance for scene in scenes],
        "safe": [scene.safe for scene in scenes],
    }
    return {name: np.stack(arrays) if batched else arrays[0] for name, arrays in columns.items()}
