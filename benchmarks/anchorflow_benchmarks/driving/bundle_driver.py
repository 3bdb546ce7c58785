"""Bundles that drive: what they are asked of a window, and what they propose."""

from __future__ import annotations

import re
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.planners import bundle_names
from anchorflow_benchmarks.samplers import CARD, parse_sampler
from anchorflow_client.contract import (
    AnchorBatch,
    OdeSpec,
    TruncatedDiffusionSpec,
    VocabularySpec,
)
from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.sensors.by_name import check_inputs, draw_inputs
from anchorflow_driving.window import Window
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.local import LocalClient

Array = NDArray[np.float64]

ROUTE = "route"
"""The input by which a bundle is told its route, where it takes one."""
ALONG_MARK = "_along_route"
"""At the end of the name of a driver that drives by its route."""
SEED_MARK = "_seed"
"""Before its number, at the end of the name of a driver whose noise is of another seed than 0."""

FORETOLD = ("sim_rewards", "sub_scores")
"""Extras [N, 5] that foretell sub-scores."""
CHOICES = ("im_rewards", "coarse_scores")
"""Extras [N] by which a bundle could choose, too."""


@dataclass(frozen=True, eq=False)
class Proposals:
    """What a bundle proposes for a window.

    trajectories: [N, 8, 3]; scores: [N], or None where the bundle gives none; best: which is driven
    foretold: [N, 5] sub-scores; choices: [N] each, by name; offsets: [N, 8, 3] from its anchors;
        of bundles that tell them
    goals: [K, 2] and goal_scores: [K], the best first, of bundles that have them
    drawing_ms, flow_ms: spent on its inputs, and between its encoder and its answer
    """

    trajectories: Array
    scores: Array | None
    foretold: Array | None
    choices: dict[str, Array]
    offsets: Array | None
    goals: Array | None
    goal_scores: Array | None
    best: int
    drawing_ms: float
    flow_ms: float


class BundleDriver:
    """Drives by the proposal with the highest score, of `num` or as many as there are; is told no
    route. Its name begins with the card's where none is given.

    Raises:
        BundleError: the bundle is broken.
        SensorError: it asks for what no log tells.
        BenchmarkError: it answers at other times than PLAN_TIMES, or has no such sampler.
    """

    def __init__(
        self,
        folder: Path,
        *,
        num: int,
        name: str = "",
        sampler: str = CARD,
        threads: int | None = None,
    ) -> None:
        bundle = load_bundle(folder)
        card = bundle.card
        check_inputs(card.inputs, of=card.name)
        if (card.time.steps, card.time.first_s, card.time.dt) != (len(PLAN_TIMES), 0.5, 0.5):
            times = f"{card.time.steps} from {card.time.first_s:g} s, {card.time.dt} s apart"
            raise BenchmarkError(f"{card.name}: expected 8 poses at 0.5 … 4.0 s, got {times}")
        # Who chooses among fewer answers all of them.
        if isinstance(card.sampler, VocabularySpec | TruncatedDiffusionSpec):
            num = min(num, card.sampler.size)
        self._options: dict[str, Any] = {"num_samples": num, "seed": 0}
        if isinstance(card.sampler, OdeSpec):
            spec = parse_sampler(sampler, card)
            self._options["sampler"] = {"method": spec.method, "schedule": list(spec.schedule)}
        elif sampler != CARD:
            raise BenchmarkError(f"{card.name}: expected sampler {CARD}, got {sampler!r}")
        extras = {spec.name for spec in card.answer.extras}
        told = ("goals", "goal_scores", "offsets", *FORETOLD, *CHOICES)
        self._told = [name for name in told if name in extras]
        self._inputs = [spec for spec in card.inputs if spec.name != ROUTE]
        self._route = [spec for spec in card.inputs if spec.name == ROUTE]
        name = name or card.name
        self.name = name if sampler == CARD else f"{name}_{sampler.replace(':', '_')}"
        self._by_route = False
        self._draws_noise = not isinstance(card.sampler, VocabularySpec)
        self._client = LocalClient(Engine(bundle, threads=threads))

    def seeded(self, seed: int) -> BundleDriver:
        """The same engine, with noise of that seed; itself for 0, and where it draws none."""
        if not seed or not self._draws_noise:
            return self
        other = copy(self)
        other._options = {**self._options, "seed": seed}
        other.name = f"{self.name}{SEED_MARK}{seed}"
        return other

    def along_route(self) -> BundleDriver:
        """The same engine, which is told its route where it takes one; elsewhere whoever asks it
        chooses by the route."""
        other = copy(self)
        other._by_route = True
        other.name = f"{self.name}{ALONG_MARK}"
        return other

    def __call__(self, window: Window, times: Array = PLAN_TIMES) -> Array:
        """Its best proposal [T, 3]; NaN at times (s) that are none of PLAN_TIMES."""
        answer, _ = self._asked(window)
        poses = answer.trajectories[self._best(answer, window)].astype(np.float64)
        plan = np.full((len(times), 3), np.nan)
        for time, pose in zip(PLAN_TIMES, poses, strict=True):
            plan[np.isclose(times, time)] = pose
        return plan

    def propose(self, window: Window) -> Proposals:
        """What it answers on a window's view."""
        answer, drawing_ms = self._asked(window)
        arrays = answer.arrays
        return Proposals(
            trajectories=np.asarray(arrays["trajectories"], np.float64),
            scores=_doubles(answer, "scores"),
            foretold=next((_doubles(answer, n) for n in FORETOLD if n in arrays), None),
            choices={n: np.asarray(arrays[n], np.float64) for n in CHOICES if n in arrays},
            offsets=_doubles(answer, "offsets"),
            goals=_doubles(answer, "goals"),
            goal_scores=_doubles(answer, "goal_scores"),
            best=self._best(answer, window),
            drawing_ms=drawing_ms,
            flow_ms=answer.timing_ms["sample"],
        )

    def _asked(self, window: Window) -> tuple[AnchorBatch, float]:
        """All that it tells of a window's view, and ms spent on its inputs."""
        started = perf_counter()
        told = [*self._inputs, *self._route] if self._by_route else self._inputs
        inputs = draw_inputs(window.view, told)
        drawing_ms = 1e3 * (perf_counter() - started)
        answer = self._client.plan(inputs=inputs, outputs=self._told, **self._options)
        return answer, drawing_ms

    def _best(self, answer: AnchorBatch, window: Window) -> int:
        if self._by_route and not self._route:
            return answer.best_along(window.view.route.points)
        return int(answer.best)


def open_drivers(
    folders: Sequence[Path], *, num: int, samplers: Sequence[str] = (CARD,), threads: int | None
) -> list[BundleDriver]:
    """One of each bundle and sampler; bundles of one name are told apart as `bundle_names` does,
    in what a file's name may hold. Raises as `BundleDriver`.
    """
    told = bundle_names([load_bundle(folder) for folder in folders])
    names = [re.sub(r"[^\w.-]+", "_", name).strip("_") for name in told]
    return [
        BundleDriver(folder, num=num, name=name, sampler=sampler, threads=threads)
        for folder, name in zip(folders, names, strict=True)
        for sampler in samplers
    ]


def _doubles(answer: AnchorBatch, name: str) -> Array | None:
    return np.asarray(answer.arrays[name], np.float64) if name in answer.arrays else None
