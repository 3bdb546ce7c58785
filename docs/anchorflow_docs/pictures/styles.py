"""What the three weights of a style change."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from anchorflow_client.contract import STYLES, AnchorBatch
from anchorflow_docs.pictures.marks import Array, draw_best, draw_ends, draw_map
from anchorflow_docs.pictures.scenes import Stage
from anchorflow_docs.pictures.theme import WIDTH, Drawing, Theme
from anchorflow_trajectory.drawing import draw_paths
from anchorflow_trajectory.scene import Scene

FAMILY, WAYS = "city", 2
DRAWN = ("conservative", "efficient", "comfortable")
PROFILES = ("clearance [m]", "speed [m/s]", "jerk [m/s³]")


def styles(stage: Stage) -> Drawing:
    """The same noise under three named styles, and the three best anchors over time."""
    scene = stage.scene_with_ways(FAMILY, WAYS)
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
    """Clearance, speed and jerk of the best anchor over time."""
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
