"""The engine: plans anchors for a request. It knows kinds of parts, not planners."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from time import perf_counter
from typing import TypeGuard

import numpy as np

from anchorflow_client.contract import AnchorBatch, ModelCard, ResolvedRequest, resolve_for_card
from anchorflow_client.contract.batch import FUTURES
from anchorflow_client.errors import InvalidRequest, UnknownModel
from anchorflow_service.bundle import Bundle, BundleError
from anchorflow_service.bundle.graphs import OnnxGraphs
from anchorflow_service.bundle.manifest import RAW_POSITIONS
from anchorflow_service.bundle.providers import DEFAULT_PROVIDER
from anchorflow_service.engine.conditioning import CONDITIONINGS
from anchorflow_service.engine.conditioning.cost_map import MapScene
from anchorflow_service.engine.finish import FINISHES
from anchorflow_service.engine.foresight import Foresight
from anchorflow_service.engine.futures import OthersFutures
from anchorflow_service.engine.interfaces import (
    DT,
    SAFE,
    Arrays,
    Check,
    ConditionedScene,
    Graphs,
    Sampler,
    Samples,
)
from anchorflow_service.engine.poses import PosePlanner
from anchorflow_service.engine.samplers import SAMPLERS
from anchorflow_service.engine.samplers.flow import drawn_round_ways
from anchorflow_service.engine.samplers.ode import FlowStates, OdeSampler
from anchorflow_trajectory.threads import usable_cores

PROBED = 16  # anchors
STAGES = ("queue", "encode", "sample", "refine", "total")


class StageClock:
    """Sums the wall-clock time [ms] of a request's stages; the server adds the queue's."""

    def __init__(self) -> None:
        self.elapsed_ms: dict[str, float] = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start = perf_counter()
        try:
            yield
        finally:
            self.elapsed_ms[name] += (perf_counter() - start) * 1e3


class Engine:
    """A bundle, ready to plan; blocking, and safe to call from several threads.

    It plans once in its constructor, so that a broken bundle fails there and not in a request.

    threads: the most that one request keeps busy; None: the cores that this process may use
    provider: of the graphs: "cpu", "cuda", "tensorrt" or "openvino"
    graphs: run in place of the bundle's own, such as those of the network that it was exported
        from; they give no `futures`, which another network predicts

    Raises:
        BundleError: the graphs of the bundle do not fit together, one cannot be opened or differs
            from the manifest, or the bundle fails at its first request.
        ProviderError: the provider is not available; there is no silent fallback.
    """

    def __init__(
        self,
        bundle: Bundle,
        *,
        threads: int | None = None,
        provider: str = DEFAULT_PROVIDER,
        graphs: Graphs | None = None,
    ) -> None:
        manifest = bundle.manifest
        kind = SAMPLERS[manifest.sampler.kind]
        self.card: ModelCard = bundle.card
        self._threads = threads or usable_cores()
        self._conditioning = CONDITIONINGS[manifest.conditioning.kind](bundle)
        for fault in chain(kind.faults(manifest), self._conditioning.faults()):
            raise bundle.fault(fault)
        is_own = graphs is None
        graphs = graphs or OnnxGraphs(bundle, threads=self._threads, provider=provider)
        predicts = is_own and FUTURES in manifest.graphs
        self._futures = OthersFutures(manifest, graphs) if predicts else None
        foresees = predicts and Foresight.is_possible(manifest)
        self._foresight = Foresight(manifest) if foresees else None
        self.sampler: Sampler = kind(manifest, graphs, threads=self._threads)
        self._finish = FINISHES[manifest.finish.kind](manifest, threads=self._threads)
        self._poses = PosePlanner(manifest, threads=self._threads)
        # Extras come from graphs, which ways do without.
        self._has_ways = manifest.finish.kind == "spline" and not manifest.answer.extras
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
            threads: the most to keep busy; None: all of the engine's.
            check: called before every stage and after every step of the sampler.

        Raises:
            InvalidRequest: the request needs something that this bundle cannot do.
            UnknownModel: it names another model.
            Exception: what `check` raises.
        """
        threads = threads or self._threads
        clock = StageClock()
        with clock.stage("total"):
            scenes = self._scenes(request)
            planned = [self._plan_scene(scene, clock, threads, check) for scene in scenes]
        answers, reasons = zip(*planned, strict=True)
        arrays = _stacked(answers, batched=request.batched)
        own = arrays.pop(DT, None)
        return AnchorBatch(
            arrays=arrays,
            dt=self._common_time_step(request) if own is None else own,
            first_s=self.card.time.first_s + request.delay_s,
            seed=request.seed,
            model=self.card.id,
            timing_ms=clock.elapsed_ms,
            request_id=request.request_id,
            reason=_joined(reasons, batched=request.batched),
            absent_inputs=tuple(
                spec.name
                for spec in self.card.inputs
                if spec.optional and spec.name not in request.inputs
            ),
        )

    def samples(self, request: ResolvedRequest, /) -> list[Samples]:
        """Return the samples of every scene before the finish. Raises as `plan`."""
        clock, check = StageClock(), lambda: None
        return [
            self._sampled(scene, clock, self._threads, check) for scene in self._scenes(request)
        ]

    def flow_states(self, request: ResolvedRequest, /) -> FlowStates:
        """Return the states that `plan` passes through on its way to the first scene's anchors.

        The finish starts from the last of them. Raises as `plan`, and if the planner has no flow.
        """
        if not isinstance(self.sampler, OdeSampler):
            raise InvalidRequest(f"expected a model with a flow, got {self.card.name}", "model")
        scene = self._scenes(request)[0]
        if self._draws_ways(scene):
            raise InvalidRequest("expected none, as anchors among them have no flow", "obstacles")
        return self.sampler.flow_states(scene)

    def _common_time_step(self, request: ResolvedRequest) -> float:
        """Return the seconds between two time steps, if they are the same for all anchors."""
        limits = request.limits
        if limits is not None and limits.horizon_s is not None:
            return limits.horizon_s / (self.card.T - 1)
        assert self.card.time.dt is not None  # the manifest has one if there is no horizon
        return self.card.time.dt

    def _scenes(self, request: ResolvedRequest) -> Sequence[ConditionedScene]:
        if request.model != self.card.name:
            raise UnknownModel(f"expected {self.card.name}, got {request.model}", "model")
        return self._conditioning.scenes(request)

    def _warm_up(self, bundle: Bundle) -> None:
        """Plan once. Raises `BundleError` if that fails or gives nonsense."""
        try:
            asked = resolve_for_card(self._conditioning.probe(), self.card)
            outputs = self._futures.names if self._futures else ()
            few = min(PROBED, asked.num_samples)
            probe = replace(asked, num_samples=few, outputs=outputs)
            self.sampler.settle(self._scenes(probe)[0])
            batch = self.plan(probe)
        except Exception as error:  # onnxruntime's exceptions share no public base
            raise BundleError(bundle.path, "the warm-up failed", str(error)) from error
        if not batch.is_finite:
            raise BundleError(bundle.path, "the warm-up gave numbers that are not finite")

    def _plan_scene(
        self, scene: ConditionedScene, clock: StageClock, threads: int, check: Check
    ) -> tuple[Arrays, str | None]:
        """Return the arrays of a scene's answer, and why none of its anchors is safe."""
        check()
        if isinstance(scene, MapScene) and scene.request.has_body:
            if RAW_POSITIONS in scene.request.outputs:
                said = f"expected no {RAW_POSITIONS}: poses of a body are searched, not sampled"
                raise InvalidRequest(said, "outputs")
            with clock.stage("refine"):
                finished = self._poses.plan(scene, threads=threads)
            return self._answer(scene, finished)
        samples = self._sampled(scene, clock, threads, check)
        with clock.stage("refine"):
            finished = self._finish.finish(samples, scene, threads=threads)
        return self._answer(scene, finished)

    def _sampled(
        self, scene: ConditionedScene, clock: StageClock, threads: int, check: Check
    ) -> Samples:
        if self._draws_ways(scene):
            with clock.stage("sample"):
                return drawn_round_ways(scene)
        with clock.stage("encode"):
            context = self.sampler.encode(scene, threads=threads)
        check()
        with clock.stage("sample"):
            samples = self.sampler.sample(scene, context, threads=threads, check=check)
            futures = self._futures.predict(scene) if self._futures else {}
            samples = replace(samples, context=context, arrays={**samples.arrays, **futures})
            if self._foresight and OthersFutures.told(scene):
                scorer = None
                if isinstance(self.sampler, OdeSampler):
                    scorer = self.sampler.scorer(scene, context, threads=threads)
                samples = self._foresight.chosen(samples, scene, futures, scorer)
        return samples

    def _draws_ways(self, scene: ConditionedScene) -> TypeGuard[MapScene]:
        """Whether the anchors of a scene are drawn without a network."""
        return self._has_ways and isinstance(scene, MapScene) and scene.scene.movers is not None

    def _answer(self, scene: ConditionedScene, finished: Arrays) -> tuple[Arrays, str | None]:
        """Return the arrays of the card and the extras that the request lists, and the reason."""
        reason = self._finish.reason(finished, scene)
        asked = scene.request.outputs
        extras = [spec.name for spec in self.card.answer.extras if spec.name in asked]
        given = [name for name in (SAFE, DT) if name in finished]
        names = dict.fromkeys(("trajectories", *self.card.answer.arrays, *extras, *given))
        return scene.answered({name: finished[name] for name in names}), reason


def _stacked(scenes: Sequence[Arrays], *, batched: bool) -> Arrays:
    """Return the arrays of an answer: the scenes' on a B axis, or those of a single scene."""
    if not batched:
        return {**scenes[0]}
    return {name: np.stack([scene[name] for scene in scenes]) for name in scenes[0]}


def _joined(reasons: Sequence[str | None], *, batched: bool) -> str | None:
    """Return the reason of an answer; that of each scene by its number if there may be several."""
    if not batched:
        return reasons[0]
    told = [f"scene {index}: {why}" for index, why in enumerate(reasons) if why is not None]
    return "; ".join(told) or None
