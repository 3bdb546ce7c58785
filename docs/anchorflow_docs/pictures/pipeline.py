"""The way of a request, in pictures: routes, noise round them, the flow, the finish."""

from __future__ import annotations

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from anchorflow_docs.pictures.fields import draw_route_splines
from anchorflow_docs.pictures.marks import draw_ends, draw_map
from anchorflow_docs.pictures.overview import draw_answer
from anchorflow_docs.pictures.scenes import Stage
from anchorflow_docs.pictures.theme import WIDTH, Drawing, Theme
from anchorflow_trajectory.drawing import draw_paths

FAMILY, WAYS = "bug_traps", 2
STEPS = ("the request", "routes", "sample: noise …", "… carried to t = 1", "refine: the answer")


def pipeline(stage: Stage) -> Drawing:
    """Five small panels with arrows between them."""
    scene = stage.scene_with_ways(FAMILY, WAYS)
    states = stage.flow_states(scene).positions
    answer = stage.plan(scene)

    def draw(theme: Theme) -> Figure:
        figure, axes = plt.subplots(1, len(STEPS), figsize=(WIDTH, 2.05), layout="constrained")
        figure.get_layout_engine().set(wspace=0.12)  # type: ignore[union-attr]
        for axis in axes[[0, 2, 3]]:
            draw_map(axis, scene, theme)
        draw_route_splines(axes[1], scene, theme)
        for axis, paths in zip(axes[2:4], states[[0, -1]], strict=True):
            draw_paths(axis, paths, theme.ways[0], alpha=0.5, linewidths=0.7)
        draw_answer(axes[4], scene, answer, theme)
        for axis in axes[:4]:
            draw_ends(axis, scene, theme)
            _arrow(axis, theme)
        for axis, step in zip(axes, STEPS, strict=True):
            axis.set_title(step)
        return figure

    return draw


def _arrow(axis: Axes, theme: Theme) -> None:
    """From this panel to the one on its right."""
    axis.annotate(
        "",
        xytext=(1.01, 0.5),
        xy=(1.15, 0.5),
        xycoords="axes fraction",
        annotation_clip=False,
        arrowprops={"arrowstyle": "-|>", "color": theme.ink, "linewidth": 1.4},
    )
