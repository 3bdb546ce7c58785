"""Make data, train a small planner, draw anchors, and plot them.

    python examples/quickstart.py --out runs/quickstart

takes about two minutes on two cores. It leaves a dataset, a checkpoint and `quickstart.png`, whose
rows show four new scenes: anchors of the untrained planner, anchors of the trained one, both
without the finish, and the latter with the finish of every answer. After so short a training the
finish still does much of the work; the loss and the middle row show what the training did.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from time import perf_counter

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from anchorflow_models import L2Config, L2SafetyCFM
from anchorflow_models.generation import AnchorTensors, GeneratorConfig, TrajectoryGenerator
from anchorflow_training.batches import FlowBatchConfig
from anchorflow_training.dataset import SceneDataset, open_dataset
from anchorflow_training.expert import ExpertConfig, solve
from anchorflow_training.make_data import DataConfig, make_dataset
from anchorflow_training.scenes import SceneError, draw_scene
from anchorflow_training.trainer import CFMTrainer, TrainerConfig
from anchorflow_trajectory.drawing import draw_cells, draw_ends, draw_paths, hide_ticks
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import Scene

BATCH_SCENES = 8
DRAWN = GeneratorConfig(num_samples=24, project=False)
FINISHED = GeneratorConfig(num_samples=24)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/quickstart"))
    parser.add_argument("--scenes", type=whole(BATCH_SCENES), default=160, help="to train on")
    parser.add_argument("--steps", type=whole(1), default=400, help="of the optimiser")
    parser.add_argument("--seed", type=whole(0), default=0)
    options = parser.parse_args(arguments)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        parser.error(f"argument --out: expected a folder to write, got {options.out} ({error})")

    with timed(f"{options.scenes} scenes, each solved by the expert many ways"):
        data = make_data(options.out / "data", options.scenes, options.seed)
    trainer = CFMTrainer(training(options.steps, options.seed), data, options.out / "run")
    scenes = new_scenes(4, limits=data.limits, seed=options.seed + 1)
    rows = {"untrained": anchors_in(scenes, trainer.averaged_model(), DRAWN)}
    with timed(f"{options.steps} steps of training"):
        trainer.fit(report)
    with timed("anchors in new scenes"):
        model = trainer.averaged_model()
        rows["trained"] = anchors_in(scenes, model, DRAWN)
        rows["finished"] = anchors_in(scenes, model, FINISHED)
    for name, row in rows.items():
        safe = np.mean([float(anchors.safe.float().mean()) for anchors in row])
        print(f"{name}: {safe:.0%} of the anchors are safe")
    picture = options.out / "quickstart.png"
    draw(scenes, rows, picture)
    print(f"{trainer.checkpoint_path}, {picture}")


def whole(least: int) -> Callable[[str], int]:
    """Return a parser of whole numbers from `least`."""

    def read(text: str) -> int:
        if not text.isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(
                f"expected a whole number of at least {least}, got {text!r}"
            )
        return int(text)

    return read


def make_data(path: Path, scenes: int, seed: int) -> SceneDataset:
    """Make random scenes with the expert's trajectories, as `anchorflow data make` does."""
    make_dataset(path, DataConfig(scenes=scenes, seed=seed), workers=os.cpu_count() or 1)
    return open_dataset(path)


def training(steps: int, seed: int) -> TrainerConfig:
    """Return a short training: small batches, and a fast moving average of the weights."""
    return TrainerConfig(
        steps=steps,
        warmup=min(50, steps),
        ema_decay=0.98,
        report_every=max(1, steps // 8),
        tensorboard=False,
        batch=FlowBatchConfig(scenes=BATCH_SCENES, samples=16, seed=seed),
        model=L2Config(variant="small"),
    )


def report(step: int, row: dict[str, float]) -> None:
    print(f"  step {step}: loss {row['loss']:.3f}", flush=True)


def new_scenes(count: int, *, limits: MotionLimits, seed: int) -> list[Scene]:
    """Draw scenes outside the training data that the expert can solve."""
    rng, scenes = np.random.default_rng(seed), []
    while len(scenes) < count:
        with suppress(SceneError):  # no room for a start and a goal: draw another
            scene = draw_scene(rng, limits=limits)
            if solve(scene, config=ExpertConfig(), rng=rng).good.any():
                scenes.append(scene)
    return scenes


def anchors_in(
    scenes: Sequence[Scene], model: L2SafetyCFM, config: GeneratorConfig
) -> list[AnchorTensors]:
    generator = TrajectoryGenerator(model, config)
    return [
        generator.generate(
            scene.cost_map,
            scene.x_curr,
            scene.x_goal,
            scene.w_style,
            resolution=scene.resolution,
            origin=scene.origin,
            robot_radius=scene.robot_radius,
            motion=scene.motion,
            seed=0,
        )
        for scene in scenes
    ]


def draw(scenes: Sequence[Scene], rows: dict[str, list[AnchorTensors]], path: Path) -> None:
    """Draw a row for each planner, a column for each scene; green anchors are safe."""
    size = 3.0 * len(scenes), 3.1 * len(rows)
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(rows), len(scenes), squeeze=False)
    for axes, (name, row) in zip(grid, rows.items(), strict=True):
        axes[0].set_ylabel(name)
        for panel, scene, anchors in zip(axes, scenes, row, strict=True):
            draw_scene_with(panel, scene, anchors)
    figure.savefig(path, dpi=100)


def draw_scene_with(axes: Axes, scene: Scene, anchors: AnchorTensors) -> None:
    draw_cells(axes, scene.cost_map[0], resolution=scene.resolution, origin=scene.origin)
    colours = np.where(anchors.safe.cpu().numpy(), "tab:green", "tab:red")
    draw_paths(axes, anchors.trajectories.cpu().numpy(), colours, linewidths=0.8)
    draw_ends(axes, scene.x_curr, scene.x_goal, colours=("black", "black"), sizes=(4, 7))
    hide_ticks(axes)


@contextmanager
def timed(what: str) -> Iterator[None]:
    print(what, flush=True)
    began = perf_counter()
    yield
    print(f"  {perf_counter() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
