"""Drive with a bundle: ask a client for proposals on a window and take the best one.

    driver = BundleDriver(LocalClient.of("bundles/goalflow"), card, num=64)
    poses = driver(window)  # [8, 3]

Any client will do: one of an engine in this process, or one of a service.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from anchorflow_client.base_client import BaseClient
from anchorflow_client.contract import (
    AnchorBatch,
    GuardSpec,
    ModelCard,
    TruncatedDiffusionSpec,
    VocabularySpec,
)
from anchorflow_client.contract.batch import FUTURES
from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.errors import SensorError
from anchorflow_driving.geometry import Array
from anchorflow_driving.sensors.inputs import check_inputs, draw_inputs
from anchorflow_driving.window import Window

ROUTE = "route"
"""Name of the input that takes the route."""
OTHERS = "others"
"""Name of the input that says who else is there."""
GOAL_EXTRAS = ("goals", "goal_scores")


@dataclass(frozen=True, eq=False)
class WindowProposals:
    """The proposals of a bundle for one window.

    trajectories: [N, 8, 3]; scores: [N], or None if the bundle has none; best: the one to drive
    goals: [K, 2] m and goal_scores: [K], best first, or None
    drawing_ms, flow_ms: time for drawing the inputs, and from the encoder to the answer
    """

    trajectories: Array
    scores: Array | None
    goals: Array | None
    goal_scores: Array | None
    best: int
    drawing_ms: float
    flow_ms: float


class BundleDriver:
    """Drives the proposal with the highest score out of `num`, without being given the route."""

    def __init__(
        self,
        client: BaseClient,
        card: ModelCard,
        *,
        num: int,
        name: str = "",
        sampler: dict[str, Any] | None = None,
    ) -> None:
        """Check that the planner of the card can drive logs.

        num: of proposals; planners that choose among fewer return all of them
        name, sampler: the card's by default

        Raises `SensorError` if the planner takes inputs that no log has, or plans other poses than
        those of PLAN_TIMES.
        """
        check_inputs(card.inputs, of=card.name)
        if (card.time.steps, card.time.first_s, card.time.dt) != (len(PLAN_TIMES), 0.5, 0.5):
            times = f"{card.time.steps} from {card.time.first_s:g} s, {card.time.dt} s apart"
            raise SensorError(f"{card.name}: expected 8 poses at 0.5 … 4.0 s, got {times}")
        if isinstance(card.sampler, VocabularySpec | TruncatedDiffusionSpec):
            num = min(num, card.sampler.size)
        self.name = name or card.name
        self._client = client
        self._options: dict[str, Any] = {"num_samples": num, "seed": 0}
        if sampler is not None:
            self._options["sampler"] = sampler
        extras = {spec.name for spec in card.answer.extras}
        self._outputs = [extra for extra in GOAL_EXTRAS if extra in extras]
        self._inputs = [spec for spec in card.inputs if spec.name not in (ROUTE, OTHERS)]
        self._route = [spec for spec in card.inputs if spec.name == ROUTE]
        self._others = [spec for spec in card.inputs if spec.name == OTHERS]
        self._follows_route = self._foresees = False
        self.predicts = FUTURES in extras
        finish = card.finish
        self.has_route_drives = isinstance(finish, GuardSpec) and finish.route_drives is not None
        self._draws_noise = not isinstance(card.sampler, VocabularySpec)

    def seeded(self, seed: int) -> BundleDriver:
        """Return this driver with another noise seed; itself for seed 0 or without noise."""
        if not seed or not self._draws_noise:
            return self
        other = copy(self)
        other._options = {**self._options, "seed": seed}
        other.name = f"{self.name}_seed{seed}"
        return other

    def along_route(self) -> BundleDriver:
        """Return this driver with the route as an input, or choosing by it if there is no input."""
        other = copy(self)
        other._follows_route = True
        other.name = f"{self.name}_along_route"
        return other

    def route_drives(self) -> BundleDriver:
        """Return this driver with the route as an input, and drives along it among the proposals:
        one of a card that `has_route_drives`."""
        other = self.along_route()
        other._options = {**self._options, "refine": {"route_drives": True}}
        other.name = f"{self.name}_route_drives"
        return other

    def guarded(self) -> BundleDriver:
        """Return this driver with the planner's guard, which answers a stop if nothing is safe."""
        other = copy(self)
        other._options = {**self._options, "refine": {"guard": True}}
        other.name = f"{self.name}_guarded"
        return other

    def foreseeing(self) -> BundleDriver:
        """Return this driver with a planner that is told of the others, and chooses by where it
        predicts them: one of a card that `predicts`."""
        other = copy(self)
        other._foresees = True
        other.name = f"{self.name}_foreseeing"
        return other

    def late(self, delay_s: float) -> BundleDriver:
        """Return this driver with plans that begin `delay_s` after what it sees.

        If the window knows what the car does until then, as a live one does, the planner is told.
        """
        other = copy(self)
        other._options = {**self._options, "delay_s": delay_s}
        return other

    @property
    def delay_s(self) -> float:
        """s from what it sees to the time from which its poses are counted."""
        return self._options.get("delay_s", 0.0)

    def __call__(self, window: Window, times: Array = PLAN_TIMES) -> Array:
        """Return the best proposal [T, 3]; NaN at times (s) other than PLAN_TIMES."""
        proposals = self.propose(window)
        plan = np.full((len(times), 3), np.nan)
        for time, pose in zip(PLAN_TIMES, proposals.trajectories[proposals.best], strict=True):
            plan[np.isclose(times, time)] = pose
        return plan

    def propose(self, window: Window) -> WindowProposals:
        """Ask for proposals on the view of a window."""
        started = perf_counter()
        specs = self._inputs + self._route * self._follows_route + self._others * self._foresees
        inputs = draw_inputs(window.view, specs)
        drawing_ms = 1e3 * (perf_counter() - started)
        last_plan = window.meanwhile if self.delay_s else None
        answer = self._client.plan(
            inputs=inputs, outputs=self._outputs, last_plan=last_plan, **self._options
        )
        chooses_by_route = self._follows_route and not self._route
        return WindowProposals(
            trajectories=np.asarray(answer.trajectories, np.float64),
            scores=_doubles(answer, "scores"),
            goals=_doubles(answer, "goals"),
            goal_scores=_doubles(answer, "goal_scores"),
            best=answer.best_along(window.view.route.points)
            if chooses_by_route
            else int(answer.best),
            drawing_ms=drawing_ms,
            flow_ms=answer.timing_ms["sample"],
        )


def _doubles(answer: AnchorBatch, name: str) -> Array | None:
    return np.asarray(answer.arrays[name], np.float64) if name in answer.arrays else None
