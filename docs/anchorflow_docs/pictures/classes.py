"""Ways past the obstacles: homology classes."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from anchorflow_docs.pictures.marks import draw_ends, draw_map
from anchorflow_docs.pictures.scenes import Stage, ways
from anchorflow_docs.pictures.theme import WIDTH, Drawing, Theme
from anchorflow_training.data.inspection import obstacle_points
from anchorflow_trajectory.drawing import draw_paths

FAMILY, WAYS = "forest", 4
MOST = 6
"""Classes that get a colour; the rarer ones are left out."""


def classes(stage: Stage) -> Drawing:
    """Anchors coloured by the way that they take, and the best of each way."""
    scene = stage.scene_with_ways(FAMILY, WAYS)
    answer = stage.plan(scene)
    way_of = ways(scene, answer)
    points = obstacle_points(scene.clearance_field, scene.resolution, scene.origin)
    count = min(int(way_of.max()) + 1, MOST)

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
