"""Pictures of answers: scenes of all families, ways, styles, warm starts, and the training loss."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from anchorflow_client.contract import STYLES, AnchorBatch
from anchorflow_docs.pictures.scenes import FAMILIES, Stage, ways
from anchorflow_docs.pictures.theme import (
    WIDTH,
    Array,
    Drawing,
    Theme,
    crop_to,
    draw_answer,
    draw_best,
    draw_ends,
    draw_map,
)
from anchorflow_training.data.inspection import obstacle_points
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.drawing import draw_paths
from anchorflow_trajectory.scene import Scene

FRONT = {"discs": 4, "rooms": 2, "forest": 3}  # families, and ways that the anchors take
MAX_CLASSES = 6  # that get a colour
DRAWN = ("conservative", "efficient", "comfortable")
PROFILES = ("clearance [m]", "speed [m/s]", "jerk [m/s³]")
TAUS = (0.5, 0.8, 0.95)


def front(stage: Stage) -> Drawing:
    """Draw three scenes with a choice of ways."""
    scenes = [stage.scene_with_ways(family, least) for family, least in FRONT.items()]
    return _sheet(stage, scenes, rows=1)


def anchors(stage: Stage) -> Drawing:
    """Draw the first scene with a free route of each of eight families."""
    scenes = [stage.scene(family, lambda scene: bool(scene.routes)) for family in FAMILIES]
    return _sheet(stage, scenes, rows=2, titled=True)


def _sheet(
    stage: Stage, scenes: Sequence[FamilyScene], *, rows: int, titled: bool = False
) -> Drawing:
    answers = [stage.plan(scene) for scene in scenes]
    columns = len(scenes) // rows

    def draw(theme: Theme) -> Figure:
        side = WIDTH / columns
        size = (WIDTH, rows * (side + 0.25 * titled))
        figure, axes = plt.subplots(
            rows, columns, figsize=size, layout="constrained", squeeze=False
        )
        for axis, scene, answer in zip(axes.flat, scenes, answers, strict=True):
            draw_answer(axis, scene, answer, theme)
            if titled:
                safe = f"{answer.safe.sum()} of {answer.safe.size} safe"
                axis.set_title(f"{scene.family.replace('_', ' ')}: {safe}")
        return figure

    return draw


def classes(stage: Stage) -> Drawing:
    """Draw anchors coloured by their way, and the best of each way."""
    scene = stage.scene_with_ways("forest", 4)
    answer = stage.plan(scene)
    way_of = ways(scene, answer)
    points = obstacle_points(scene.clearance_field, scene.resolution, scene.origin)
    count = min(int(way_of.max()) + 1, MAX_CLASSES)

    def draw(theme: Theme) -> Figure:
        figure, (left, right) = plt.subplots(1, 2, figsize=(WIDTH, 5.1), layout="constrained")
        for axis in (left, right):
            draw_map(axis, scene, theme)
        right.plot(*points.T, "x", color=theme.page, markersize=5, markeredgewidth=1.4)
        for way, colour in zip(range(count), theme.ways, strict=False):
            of_way = np.flatnonzero(way_of == way)
            draw_paths(left, answer.trajectories[of_way], colour, alpha=0.8)
            best = of_way[answer.scores[of_way].argmax()]
            right.plot(
                *answer.trajectories[best, :, :2].T,
                color=colour,
                linewidth=2.4,
                path_effects=[withStroke(linewidth=4.4, foreground=theme.ground)],
                label=f"{len(of_way)} anchors, least cost {-answer.scores[best]:.2f}",
            )
        for axis in (left, right):
            draw_ends(axis, scene, theme)
        left.set_title(f"{len(way_of)} anchors, {way_of.max() + 1} classes")
        right.set_title("the best of each class")
        figure.legend(loc="outside lower center", ncols=3)
        return figure

    return draw


def styles(stage: Stage) -> Drawing:
    """Draw the same noise in three named styles, and the three best anchors over time."""
    scene = stage.scene_with_ways("city", 2)
    answers = {name: stage.plan(scene, w_style=name) for name in DRAWN}

    def draw(theme: Theme) -> Figure:
        figure, axes = plt.subplots(
            2, 3, figsize=(WIDTH, 5.6), layout="constrained", height_ratios=(3, 2)
        )
        colours = dict(zip(answers, theme.ways, strict=False))
        for axis, (name, answer) in zip(axes[0], answers.items(), strict=True):
            draw_map(axis, scene, theme)
            draw_paths(axis, answer.trajectories, colours[name], alpha=0.35)
            draw_best(axis, answer, theme, colours[name])
            draw_ends(axis, scene, theme)
            axis.set_title(f"{name}: {', '.join(map(str, STYLES[name]))}")
        for name, answer in answers.items():
            _draw_profile(axes[1], scene, answer, colours[name])
        for axis, title in zip(axes[1], PROFILES, strict=True):
            axis.set(xlabel="time [s]", title=title, xlim=(0, None), ylim=(0, None))
            axis.grid()
        return figure

    return draw


def _draw_profile(axes: Array, scene: Scene, answer: AnchorBatch, colour: str) -> None:
    """Draw clearance, speed and jerk of the best anchor over time."""
    best = answer.best
    position, velocity, acceleration = (
        np.asarray(array[best], np.float64)
        for array in (answer.trajectories, answer.velocities, answer.accelerations)
    )
    field = scene.cost_fields.clearance
    time = np.linspace(0.0, answer.durations[best], len(position))
    profiles = (
        field.sample(*position[:, :2].T),
        np.linalg.norm(velocity, axis=-1),
        np.linalg.norm(np.gradient(acceleration, time, axis=0), axis=-1),
    )
    for axis, values in zip(axes, profiles, strict=True):
        axis.plot(time, values, color=colour, linewidth=1.6)


def warm_start(stage: Stage) -> Drawing:
    """Draw answers from noise, and from a trajectory of a rare way, by tau."""
    scene = stage.scene_with_ways("discs", 3)
    cold = stage.plan(scene)
    way_of = ways(scene, cold)
    chosen = int((way_of == way_of.max()).argmax())
    given = cold.trajectories[chosen]
    plan = {"trajectory": given, "dt": cold.durations[chosen] / (len(given) - 1)}
    answers = [cold] + [stage.plan(scene, warm_start=plan | {"tau": tau}) for tau in TAUS]
    titles = ["from noise", *(f"τ = {tau}" for tau in TAUS)]

    def draw(theme: Theme) -> Figure:
        figure, axes = plt.subplots(2, 2, figsize=(WIDTH, 4.6), layout="constrained")
        for axis, answer, title in zip(axes.flat, answers, titles, strict=True):
            draw_map(axis, scene, theme)
            draw_paths(axis, answer.trajectories, theme.ways[0], alpha=0.5)
            draw_paths(axis, given[None], theme.goal, linewidths=1.8, linestyles=[(0, (3, 2))])
            draw_ends(axis, scene, theme)
            crop_to(axis, scene, cold.trajectories)
            axis.set_title(title)
        return figure

    return draw


def loss(stage: Stage) -> Drawing:
    """Draw the training loss in the bundle's manifest."""
    card = stage.engine.card
    steps, values = np.array(card.training["loss"]).T

    def draw(theme: Theme) -> Figure:
        figure, axis = plt.subplots(figsize=(WIDTH * 0.8, 3.2), layout="constrained")
        axis.plot(steps, values, color=theme.ways[0])
        axis.set(xlabel="step", ylabel="loss", yscale="log", title=card.name)
        axis.grid()
        return figure

    return draw
