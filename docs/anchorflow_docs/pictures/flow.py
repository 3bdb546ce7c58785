"""From noise to trajectories: the states that the flow passes through, and the finish."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from anchorflow_docs.pictures.marks import Array, draw_ends, draw_map
from anchorflow_docs.pictures.overview import draw_answer
from anchorflow_docs.pictures.scenes import Stage
from anchorflow_docs.pictures.theme import WIDTH, Drawing, Theme
from anchorflow_trajectory.drawing import draw_paths
from anchorflow_trajectory.scene import Scene

FAMILY, WAYS = "forest", 4
TIMES = (0.0, 0.5, 0.8, 1.0)
STEPS = 10
"""Equal strides, which visit all TIMES."""
FOLLOWED = 3
"""Anchors whose ways through the flow are drawn in the last panel."""


def flow(stage: Stage) -> Drawing:
    """The same noise at five moments, and single anchors at all of them."""
    scene = stage.scene_with_ways(FAMILY, WAYS)
    sampler = {"method": "rk4", "schedule": {"uniform": STEPS}}
    states = stage.flow_states(scene, sampler=sampler)
    answer = stage.plan(scene, sampler=sampler)
    moments = [states.positions[_index(states.times, t)] for t in TIMES]
    moments.append(answer.trajectories)
    names = [f"t = {t:g}" for t in TIMES]
    names[0] += ", noise"
    names[-1] += ", the network's proposal"

    def draw(theme: Theme) -> Figure:
        figure, axes = plt.subplots(2, 3, figsize=(WIDTH, 6.6), layout="constrained")
        for axis, name, paths in zip(axes.flat, names, moments, strict=False):
            draw_map(axis, scene, theme)
            draw_paths(axis, paths, theme.ways[0], alpha=0.55)
            draw_ends(axis, scene, theme)
            axis.set_title(name)
        draw_answer(axes[1, 1], scene, answer, theme)
        axes[1, 1].set_title("finished")
        _draw_followed(axes[1, 2], scene, moments, theme)
        return figure

    return draw


def _draw_followed(axis: Axes, scene: Scene, moments: list[Array], theme: Theme) -> None:
    draw_map(axis, scene, theme)
    for n, colour in enumerate(theme.ways[:FOLLOWED]):
        for shade, paths in zip(np.linspace(0.2, 1.0, len(moments)), moments, strict=True):
            draw_paths(axis, paths[n : n + 1], colour, alpha=shade, linewidths=0.6 + 1.6 * shade)
    draw_ends(axis, scene, theme)
    axis.set_title("three of them, at all five moments")


def _index(times: NDArray[np.float64], wanted: float) -> int:
    return int(np.abs(times - wanted).argmin())
