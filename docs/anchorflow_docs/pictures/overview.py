"""What an answer looks like, on scenes of several families."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from anchorflow_client.contract import AnchorBatch
from anchorflow_docs.pictures.marks import draw_anchors, draw_ends, draw_map
from anchorflow_docs.pictures.scenes import FAMILIES, Stage
from anchorflow_docs.pictures.theme import WIDTH, Drawing, Theme
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.scene import Scene

FRONT = {"discs": 4, "rooms": 2, "forest": 3}
"""Families, and the ways that the anchors take at least."""


def front(stage: Stage) -> Drawing:
    """Three scenes in a row on which there is a choice."""
    scenes = [stage.scene_with_ways(family, least) for family, least in FRONT.items()]
    return _sheet(stage, scenes, rows=1)


def anchors(stage: Stage) -> Drawing:
    """The first scene with a free route of each of eight families, with the share that is safe."""
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


def draw_answer(axis: Axes, scene: Scene, answer: AnchorBatch, theme: Theme) -> None:
    """Map, anchors, start and goal."""
    draw_map(axis, scene, theme)
    draw_anchors(axis, answer, theme)
    draw_ends(axis, scene, theme)
