"""The engine: a request in, anchors out. It knows kinds of parts, not planners."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from anchorflow_client.contract import AnchorBatch, ModelCard, ResolvedRequest, resolve_for_card
from anchorflow_client.errors import InvalidRequest, UnknownModel
from anchorflow_service.bundle import Bundle, BundleError
from anchorflow_service.bundle.providers import DEFAULT_PROVIDER
from anchorflow_service.engine.conditioning import CONDITIONINGS
from anchorflow_service.engine.finish import FINISHES
from anchorflow_service.engine.parts import DT, Arrays, Check, ConditionedScene, Sampler
from anchorflow_service.engine.samplers import SAMPLERS
from anchorflow_service.engine.samplers.ode import FlowStates, OdeSampler
from anchorflow_service.engine.timing import StageClock
from anchorflow_trajectory.threads import usable_cores

PROBED = 16  # anchors


class Engine:
    """A bundle, ready to plan; blocking, and safe to call from several threads.

    It has planned once when it is made: what is broken is found there, and not by a caller.

    threads: that one request may keep busy; None: the cores that this process may use
    provider: where the graphs run: "cpu", "cuda", "tensorrt" or "openvino"

    Raises:
        BundleError: the graphs of the bundle cannot be wired together, one cannot be opened or is
            not what the manifest says, or the bundle fails at its first request.
        ProviderError: the provider is not to be had; nothing falls back in silence.
    """

    def __init__(
        self, bundle: Bundle, *, threads: int | None = None, provider: str = DEFAULT_PROVIDER
    ) -> None:
        manifest = bundle.manifest
        kind = SAMPLERS[manifest.sampler.kind]
        self.card: ModelCard = bundle.card
        self._threads = threads or usable_cores()
        self._conditioning = CONDITIONINGS[manifest.conditioning.kind](bundle)
        for fault in chain(kind.faults(manifest), self._conditioning.faults()):
            raise bundle.fault(fault)
        self.sampler: Sampler = kind(bundle, threads=self._threads, provider=provider)
        self._finish = FINISHES[manifest.finish.kind](manifest, threads=self._threads)
        self._warm_up(bundle)

    def plan(
        self,
        request: ResolvedRequest,
        /,
        *,
        threads: int | None = None,
        check: Check = lambda: None,
    ) -> AnchorBatch:
        """Draw and finish anchors for every scene of a request.

        Scenes are planned one after the other from the same noise, so that an answer is the same
        to the last bit, alone or in a batch, and on however many threads.

        Args:
            request: what to plan, resolved for this engine's card.
            threads: to keep busy; None: all of the engine's.
            check: called before every stage and after every step of the sampler.

        Raises:
            InvalidRequest: the request asks what this bundle cannot do.
            UnknownModel: it asks for another model.
            Exception: what `check` raises.
        """
        threads = threads or self._threads
        clock = StageClock()
        with clock.stage("total"):
            scenes = self._scenes(request)
            answers = [self._plan_scene(scene, clock, threads, check) for scene in scenes]
        arrays = _stacked(answers, batched=request.batched)
        own = arrays.pop(DT, None)
        return AnchorBatch(
            arrays=arrays,
            dt=self._common_time_step(request) if own is None else own,
            first_s=self.card.time.first_s,
            seed=request.seed,
            model=self.card.id,
            timing_ms=clock.elapsed_ms,
            request_id=request.request_id,
            absent_inputs=tuple(
                spec.name
                for spec in self.card.inputs
                if spec.optional and spec.name not in request.inputs
            ),
        )

    def flow_states(self, request: ResolvedRequest, /) -> FlowStates:
        """The states that `plan` passes through on its way to the first scene's anchors.

        The last of them is what the finish starts from.

        Raises:
            InvalidRequest, UnknownModel: as `plan`; the planner has no flow.
        """
        if not isinstance(self.sampler, OdeSampler):
            raise InvalidRequest(f"expected a model with a flow, got {self.card.name}", "model")
        return self.sampler.flow_states(self._scenes(request)[0])

    def _common_time_step(self, request: ResolvedRequest) -> float:
        """s between two time steps where all anchors are alike."""
        limits = request.limits
        if limits is not None and limits.horizon_s is not None:
            return limits.horizon_s / (self.card.T - 1)
        assert self.card.time.dt is not None  # the manifest has one where there is no horizon
        return self.card.time.dt

    def _scenes(self, request: ResolvedRequest) -> Sequence[ConditionedScene]:
        if request.model != self.card.name:
            raise UnknownModel(f"expected {self.card.name}, got {request.model}", "model")
        return self._conditioning.scenes(request)

    def _warm_up(self, bundle: Bundle) -> None:
        """Plan once. Raises `BundleError` where that fails or gives nonsense."""
        try:
            asked = resolve_for_card(self._conditioning.probe(), self.card)
            probe = replace(asked, num_samples=min(PROBED, asked.num_samples))
            self.sampler.settle(self._scenes(probe)[0])
            batch = self.plan(probe)
        except Exception as error:  # onnxruntime's exceptions share no public base
            raise BundleError(bundle.path, "the warm-up failed", str(error)) from error
        if not batch.is_finite:
            raise BundleError(bundle.path, "the warm-up gave numbers that are not finite")

    def _plan_scene(
        self, scene: ConditionedScene, clock: StageClock, threads: int, check: Check
    ) -> Arrays:
        check()
        with clock.stage("encode"):
            context = self.sampler.encode(scene, threads=threads)
        check()
        with clock.stage("sample"):
            samples = self.sampler.sample(scene, context, threads=threads, check=check)
        with clock.stage("refine"):
            finished = self._finish.finish(samples, scene, threads=threads)
        asked = scene.request.outputs
        extras = [spec.name for spec in self.card.answer.extras if spec.name in asked]
        names = ("trajectories", *self.card.answer.arrays, *extras)
        timed = {DT: finished[DT]} if DT in finished else {}
        return scene.answered({name: finished[name] for name in names} | timed)


def _stacked(scenes: Sequence[Arrays], *, batched: bool) -> Arrays:
    """The arrays of an answer: those of the scenes on a B axis, or of the only one without."""
    if not batched:
        return {**scenes[0]}
    return {name: np.stack([scene[name] for scene in scenes]) for name in scenes[0]}
