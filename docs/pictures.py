"""Draw the pictures of the documentation: `python docs/pictures.py` after `make test`."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from anchorflow_client.contract import AnchorBatch, AnchorRequest, CostMap
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_training.scenes import Scene, SceneError, draw_scene
from anchorflow_training.scenes.scene import Limits

IMAGES = Path(__file__).parent / "images"
SEED, ROWS, COLUMNS = 2026, 2, 4
FAMILIES = ("rooms", "posts", "maze", "bug_traps", "city", "gaps", "discs", "forest")


def main() -> None:
    IMAGES.mkdir(exist_ok=True)
    engine = Engine(load_bundle(DEFAULT_BUNDLE))
    loss_curve(engine, IMAGES / "loss.png")
    anchors_sheet(engine, IMAGES / "anchors.png")


def loss_curve(engine: Engine, path: Path) -> None:
    """The default bundle's training loss, as its manifest holds it."""
    steps, loss = np.array(engine.card.training["loss"]).T
    figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
    axes.plot(steps, loss)
    axes.set(xlabel="step", ylabel="loss", yscale="log", title=engine.card.name)
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def anchors_sheet(engine: Engine, path: Path) -> None:
    """64 anchors on a drawn scene of each of some families."""
    figure, axes = plt.subplots(ROWS, COLUMNS, figsize=(14, 7.2), layout="constrained")
    for axis, family in zip(axes.flat, FAMILIES, strict=True):
        scene = drawn(family, engine)
        draw(axis, scene, plan(engine, scene))
    figure.savefig(path, dpi=80)


def drawn(family: str, engine: Engine) -> Scene:
    """The first scene of a family from the seed that spans some metres."""
    card, rng = engine.card, np.random.default_rng([SEED, FAMILIES.index(family)])
    limits = Limits(card.v_max, card.a_max, card.horizon_s)
    while True:
        try:
            scene = draw_scene(rng, limits=limits)
        except SceneError:
            continue
        far = np.linalg.norm(scene.x_goal[:2] - scene.x_curr[:2]) > 5.0
        if scene.family == family and far and scene.resolution < 0.14:
            return scene


def plan(engine: Engine, scene: Scene) -> AnchorBatch:
    request = AnchorRequest.build(
        cost_map=CostMap.build(scene.cost_map, scene.resolution, scene.origin),
        x_curr=scene.x_curr,
        x_goal=scene.x_goal,
        w_style=scene.style,
        robot_radius=scene.robot_radius,
        seed=0,
    )
    return engine.plan(request)


def draw(axis: plt.Axes, scene: Scene, anchors: AnchorBatch) -> None:
    """Map, anchors (those that are not safe dashed), start and goal."""
    (left, bottom), side = scene.origin, scene.resolution * scene.cost_map.shape[-1]
    extent = (left, left + side, bottom, bottom + side)
    axis.imshow(scene.cost_map[0], origin="lower", extent=extent, cmap="Greys", vmax=1.3)
    order = np.argsort(anchors.scores)
    for rank, n in enumerate(order):
        colour = plt.get_cmap("viridis")(rank / len(order))
        style = "-" if anchors.safe[n] else "--"
        axis.plot(*anchors.trajectories[n, :, :2].T, style, color=colour, linewidth=1)
    axis.plot(*scene.x_curr[:2], "o", color="tab:green")
    axis.plot(*scene.x_goal[:2], "*", color="tab:red", markersize=12)
    axis.set(xlim=extent[:2], ylim=extent[2:], xticks=[], yticks=[])
    title = f"{scene.family}, {side:.0f} m: {anchors.safe.sum()} of {len(anchors.safe)} safe"
    axis.set_title(title, fontsize=10)


if __name__ == "__main__":
    main()
