"""How near a warm start's answers stay to the trajectory that was given."""

from __future__ import annotations

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from anchorflow_docs.pictures.marks import crop_to, draw_ends, draw_map
from anchorflow_docs.pictures.scenes import Stage, ways
from anchorflow_docs.pictures.theme import WIDTH, Drawing, Theme
from anchorflow_trajectory.drawing import draw_paths

FAMILY, WAYS = "discs", 3
TAUS = (0.5, 0.8, 0.95)


def warm_start(stage: Stage) -> Drawing:
    """Answers from noise, and from a trajectory of a way that few anchors take, by tau."""
    scene = stage.scene_with_ways(FAMILY, WAYS)
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
