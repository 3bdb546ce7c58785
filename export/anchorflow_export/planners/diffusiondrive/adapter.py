"""DiffusionDriveV2 on its way to a bundle: four graphs, each tried at sizes of its own."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from anchorflow_client.contract import AnchorRequest, TensorSpec, resolve_for_card
from anchorflow_export.adapter import GraphTrial, PlannerParts, SampleTrial, TracedGraph
from anchorflow_export.planners.sensors import perceived, random_sensors, sensor_inputs
from anchorflow_export.planners.specs import COMPONENTS, F32
from anchorflow_export.tracing import trace_role
from anchorflow_models.diffusiondrive import DiffusionDriveV2
from anchorflow_models.diffusiondrive.config import FIRST_S, POSES, SCHEDULES, STEP_S
from anchorflow_models.sub_scores import SUB_SCORES
from anchorflow_models.transfuser import AGENT_QUERIES
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.manifest import (
    AnswerEntry,
    NoFinishEntry,
    TensorsEntry,
    TimeEntry,
    TruncatedDiffusionEntry,
)
from anchorflow_service.bundle.samplers import NoiseLevelsEntry
from anchorflow_service.engine.conditioning.tensors import TensorConditioning
from anchorflow_service.engine.samplers.truncated_diffusion import (
    Noise,
    TruncatedDiffusionSampler,
)
from anchorflow_trajectory.ode.ddim import CLEAN, ddim_step, noised

Outputs = dict[str, Tensor]
Told = TypeVar("Told")

OUTPUTS = {
    "encode": (
        *("anchors", "bev", "values", "agent_queries", "ego_query", "ego_motion", "foretold"),
        *("agents", "agent_scores", "bev_semantics"),
    ),
    "denoise": ("x_0", "trajectories", "class_scores"),
    "coarse": ("candidates", "features", "coarse_scores", "coarse_logits", "coarse_imitation"),
    "fine": ("scores", "sub_scores", "direction_scores"),
}


@dataclass(frozen=True)
class Trial:
    """Sizes that graphs are tried at; none is the one it was traced at."""

    B: int
    N: int
    V: int


TRIALS = (Trial(1, 20, 2), Trial(3, 5, 1))
SAMPLED = 5  # anchors that a sample trial asks for


def start_level(model: DiffusionDriveV2, noise_scale: float) -> int:
    """The level whose noise has a spread nearest to so many times that of the model's start."""
    spread = (1.0 - model.config.noise_levels.signal) ** 0.5
    return int(np.abs(spread - noise_scale * spread[model.config.start]).argmin())


@dataclass(frozen=True)
class DiffusionDriveAdapter:
    """Four graphs, and the sampler that the network's configuration describes.

    start: the level whose noise anchors begin with
    """

    model: DiffusionDriveV2
    start: int

    @property
    def parts(self) -> PlannerParts:
        """A planner asked with tensors, a "truncated_diffusion" sampler and no finish."""
        config, levels = self.model.config, self.model.config.noise_levels
        direction = TensorSpec("direction_scores", F32, ("B", "N"), range=(0.0, 1.0))
        return PlannerParts(
            inputs=sensor_inputs(config.backbone),
            conditioning=TensorsEntry(),
            sampler=TruncatedDiffusionEntry(
                anchors=config.anchors,
                groups=config.groups,
                variants=config.variants,
                vocabulary=config.vocabulary,
                keep=config.keep,
                noise=NoiseLevelsEntry(levels=levels.levels, first=levels.first, last=levels.last),
                start=self.start,
                schedules=tuple(SCHEDULES.values()),
                steps=config.steps,
            ),
            finish=NoFinishEntry(),
            time=TimeEntry(steps=POSES, first_s=FIRST_S, dt=STEP_S),
            answer=AnswerEntry(
                components=COMPONENTS,
                arrays=("scores",),
                extras=(
                    TensorSpec("coarse_scores", F32, ("B", "N"), range=(0.0, 1.0)),
                    TensorSpec("sub_scores", F32, ("B", "N", len(SUB_SCORES)), range=(0.0, 1.0)),
                    *((direction,) if config.direction else ()),
                    *perceived(config.backbone, agents=AGENT_QUERIES, classes=config.classes),
                ),
            ),
        )

    def trace(self) -> dict[str, TracedGraph]:
        """encode, denoise, coarse and fine, each fed with what the ones before give."""
        graphs: dict[str, TracedGraph] = {}
        given = {
            spec.name: spec
            for spec in (
                *sensor_inputs(self.model.config.backbone),
                TensorSpec("x_t", F32, ("B", "N", POSES, 2), range=(-1.0, 1.0)),
                TensorSpec("t", F32, ("B",), range=(0.0, 50.0)),
                TensorSpec("diversity", F32, ("B", "N", "V", 2), range=(-1.0, 1.0)),
            )
        }
        for role in OUTPUTS:
            inputs = self._inputs(role, given)
            outputs = _outputs(self.model, role)
            graphs[role] = trace_role(self.model, role, inputs=inputs, outputs=outputs)
            given |= {spec.name: _of_anchors(spec) for spec in graphs[role].outputs}
        return graphs

    def _inputs(self, role: str, given: dict[str, TensorSpec]) -> tuple[TensorSpec, ...]:
        return tuple(_taken(getattr(self.model, role), given).values())

    def graph_trials(self, bundle: Bundle) -> Iterator[GraphTrial]:
        """Every graph at several sizes, each fed from torch's own outputs."""
        for seed, trial in enumerate(TRIALS):
            generator = torch.Generator().manual_seed(seed)
            inputs = random_sensors(bundle, trial.B, generator)
            yield from self._graph_trials(trial, inputs, generator)

    def _graph_trials(
        self, trial: Trial, inputs: Outputs, generator: torch.Generator
    ) -> Iterator[GraphTrial]:
        model, B = self.model, trial.B
        told = {**inputs, **model.encode(**inputs)}
        yield GraphTrial(f"encode at {trial}", "encode", inputs, told)
        told["x_t"] = 2 * torch.rand(B, trial.N, POSES, 2, generator=generator) - 1
        told["t"] = 50 * torch.rand(B, generator=generator)
        told["diversity"] = torch.randn(B, trial.N, trial.V, 2, generator=generator)
        for role in ("denoise", "coarse", "fine"):
            fed = _taken(getattr(model, role), told)
            told |= getattr(model, role)(**fed)
            yield GraphTrial(f"{role} at {trial}", role, fed, told)

    def sample_trials(self, bundle: Bundle) -> Iterator[SampleTrial]:
        """The engine's best of two scenes at every number of steps, beside torch's."""
        inputs = random_sensors(bundle, 2, torch.Generator().manual_seed(len(TRIALS)))
        sampler = TruncatedDiffusionSampler(bundle, threads=1, provider="cpu")
        count = min(SAMPLED, self.model.config.keep)
        for steps in SCHEDULES:
            request = AnchorRequest.build(
                inputs={name: tensor.numpy() for name, tensor in inputs.items()},
                num_samples=count,
                seed=steps,
                sampler={"schedule": {"uniform": steps}},
            )
            resolved = resolve_for_card(request, bundle.card)
            noise = sampler.draw_noise(seed=steps)
            for b, scene in enumerate(TensorConditioning(bundle.manifest).scenes(resolved)):
                encoded = sampler.encode(scene, threads=1)
                drawn = sampler.sample(scene, encoded, threads=1, check=lambda: None)
                own = {name: tensor[b : b + 1] for name, tensor in inputs.items()}
                told = torch_sample(self.model, own, noise, start=self.start, steps=steps)
                kept = {name: tensor.numpy() for name, tensor in told.items()}
                where = f"{steps} steps in scene {b}"
                # Scores nearly equal may stand in either order, so each is found by its place.
                apart = np.abs(drawn.states[:, None] - kept["trajectories"]).max((-2, -1))
                nearest = apart.argmin(1)
                for name, got in {"trajectories": drawn.states, **drawn.arrays}.items():
                    if name in kept:
                        yield SampleTrial(
                            f"{where}, {name}", got, kept[name][nearest], relative=True
                        )
                got, best = drawn.arrays["scores"], kept["scores"][:count]
                yield SampleTrial(f"{where}, the best first", got, best, relative=True)


def torch_sample(
    model: DiffusionDriveV2, inputs: Outputs, noise: Noise, *, start: int, steps: int
) -> Outputs:
    """The sampler written the plain way for one scene: all that are kept, the best first."""
    config, signal = model.config, model.config.noise_levels.signal
    told = model.encode(**inputs)
    anchors = told["anchors"].repeat(1, config.groups, 1, 1)
    x = noised(anchors, torch.from_numpy(noise.start)[None], float(signal[start]))
    levels = SCHEDULES[steps]
    for level, after in zip(levels, (*levels[1:], None), strict=True):
        told |= {"x_t": x, "t": torch.tensor([float(level)])}
        told |= model.denoise(**_taken(model.denoise, told))
        following = CLEAN if after is None else float(signal[after])
        x = ddim_step(x, told["x_0"], float(signal[level]), following=following)
    told["diversity"] = torch.from_numpy(noise.diversity)[None]
    told |= model.coarse(**_taken(model.coarse, told))
    best = told["coarse_scores"][0].argsort(descending=True, stable=True)[: config.keep]
    told |= {name: told[name][:, best] for name in _outputs(model, "coarse")}
    told |= model.fine(**_taken(model.fine, told))
    best = told["scores"][0].argsort(descending=True, stable=True)
    chosen = ("scores", "sub_scores", "direction_scores", "coarse_scores")
    picked = {name: told[name][0, best] for name in chosen if name in told}
    return {"trajectories": told["candidates"][0, best], **picked}


def _outputs(model: DiffusionDriveV2, role: str) -> tuple[str, ...]:
    """The ego's motion and where others will be only where the scorers are told; what `coarse`
    foretells only where it counts with what `fine` does; the direction only where it is foretold.
    """
    config = model.config
    unread = set() if config.ego_motion else {"ego_motion"}
    if not config.encounters:
        unread |= {"foretold"}
    if not config.pessimistic:
        unread |= {"coarse_logits", "coarse_imitation"}
    if not config.imitation:
        unread |= {"coarse_imitation"}
    if not config.direction:
        unread |= {"direction_scores"}
    return tuple(name for name in OUTPUTS[role] if name not in unread)


def _taken(method: Callable[..., Outputs], told: Mapping[str, Told]) -> dict[str, Told]:
    """What a method of the network takes by name; what it can do without need not be there."""
    parameters = inspect.signature(method).parameters.values()
    wanted = [p.name for p in parameters if p.name in told or p.default is p.empty]
    return {name: told[name] for name in wanted}


def _of_anchors(spec: TensorSpec) -> TensorSpec:
    """An output as the input of a later graph, where an axis that was computed has a name."""
    axes = tuple("M" if isinstance(a, str) and not a.isidentifier() else a for a in spec.shape)
    return TensorSpec(spec.name, spec.dtype, axes, spec.unit, spec.range)
