"""Bundles that drive: what they are asked of a window, and what they propose."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.samplers import CARD, parse_sampler
from anchorflow_client.contract import AnchorBatch, OdeSpec, TensorSpec
from anchorflow_client.sensors import resize_image
from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.sensors.bev import draw_bev
from anchorflow_driving.sensors.lidar import simulated_lidar
from anchorflow_driving.sensors.status import status_of
from anchorflow_driving.window import PlannerView, Window
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.local import LocalClient

Array = NDArray[np.float64]

SEED = 0

Sensor = Callable[[PlannerView, TensorSpec], NDArray[Any]]


def _camera(view: PlannerView, spec: TensorSpec) -> NDArray[np.uint8]:
    """The simulated cameras, in the size that the card asks for."""
    # Here, because it needs the extra "driving", which other bundles do without.
    from anchorflow_driving.sensors.cameras import simulated_camera
    from anchorflow_driving.sensors.rendering import Renderer

    if not _RENDERER:
        _RENDERER.append(Renderer())
    rows, columns = (int(size) for size in spec.shape[-2:])
    picture = simulated_camera(view, _RENDERER[0]).transpose(1, 2, 0)
    return resize_image(picture, rows=rows, columns=columns).transpose(2, 0, 1)


_RENDERER: list[Any] = []  # one a process: it holds a context of the graphics driver

SENSORS: Mapping[str, Sensor] = {
    "bev": lambda view, _: draw_bev(view),
    "camera": _camera,
    "ego_status": lambda view, _: status_of(view),
    "lidar": lambda view, _: simulated_lidar(view),
    "vehicle_size": lambda view, _: view.vehicle.size.astype(np.float32),
}
"""What a bundle may ask for, by the name of its input; camera and LiDAR are simulated."""


@dataclass(frozen=True, eq=False)
class Proposals:
    """What a bundle proposes for a window.

    trajectories: [N, 8, 3]; scores: [N], or None where the bundle gives none
    goals: [K, 2] and goal_scores: [K], the best first, of bundles that have them
    drawing_ms, flow_ms: spent on its inputs, and between its encoder and its answer
    """

    trajectories: Array
    scores: Array | None
    goals: Array | None
    goal_scores: Array | None
    drawing_ms: float
    flow_ms: float

    @property
    def best(self) -> int:
        """The one with the highest score; the first where there are none."""
        return 0 if self.scores is None else int(self.scores.argmax())


class BundleDriver:
    """Drives by the proposal with the highest score.

    Raises:
        BundleError: the bundle is broken.
        BenchmarkError: it asks for what no log tells, answers at other times than PLAN_TIMES, or
            has no such sampler.
    """

    def __init__(
        self, folder: Path, *, num: int, sampler: str = CARD, threads: int | None = None
    ) -> None:
        bundle = load_bundle(folder)
        card = bundle.card
        unknown = [spec.name for spec in card.inputs if spec.name not in SENSORS]
        if unknown:
            known = ", ".join(SENSORS)
            raise BenchmarkError(f"{card.name}: expected inputs among {known}, got {unknown[0]}")
        if (card.time.steps, card.time.first_s, card.time.dt) != (len(PLAN_TIMES), 0.5, 0.5):
            times = f"{card.time.steps} from {card.time.first_s:g} s, {card.time.dt} s apart"
            raise BenchmarkError(f"{card.name}: expected 8 poses at 0.5 … 4.0 s, got {times}")
        self._options: dict[str, Any] = {"num_samples": num, "seed": SEED}
        if isinstance(card.sampler, OdeSpec):
            spec = parse_sampler(sampler, card)
            self._options["sampler"] = {"method": spec.method, "schedule": list(spec.schedule)}
        elif sampler != CARD:
            raise BenchmarkError(f"{card.name}: expected sampler {CARD}, got {sampler!r}")
        extras = {spec.name for spec in card.answer.extras}
        self._goals = [name for name in ("goals", "goal_scores") if name in extras]
        self._inputs = card.inputs
        self.name = card.name if sampler == CARD else f"{card.name}_{sampler.replace(':', '_')}"
        self._client = LocalClient(Engine(bundle, threads=threads))

    def propose(self, window: Window) -> Proposals:
        """What it answers on a window's view."""
        started = perf_counter()
        inputs = {spec.name: SENSORS[spec.name](window.view, spec) for spec in self._inputs}
        drawing_ms = 1e3 * (perf_counter() - started)
        answer = self._client.plan(inputs=inputs, outputs=self._goals, **self._options)
        arrays = answer.arrays
        return Proposals(
            trajectories=np.asarray(arrays["trajectories"], np.float64),
            scores=_doubles(answer, "scores"),
            goals=_doubles(answer, "goals"),
            goal_scores=_doubles(answer, "goal_scores"),
            drawing_ms=drawing_ms,
            flow_ms=answer.timing_ms["sample"],
        )


def _doubles(answer: AnchorBatch, name: str) -> Array | None:
    return np.asarray(answer.arrays[name], np.float64) if name in answer.arrays else None
