"""Picture of a robot that drives by anchors: its map, the anchors, and the route in use."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from anchorflow_benchmarks.closed_loop.drive import Drive, DriveConfig, Tick
from anchorflow_benchmarks.closed_loop.mppi import MppiConfig, MppiController
from anchorflow_benchmarks.closed_loop.robots import Unicycle
from anchorflow_benchmarks.closed_loop.simulated_time import LatencyExecutor, SimulatedTime
from anchorflow_benchmarks.closed_loop.worlds import World, draw_world
from anchorflow_client.planner import Planner
from anchorflow_docs.pictures.scenes import QUICK, Stage
from anchorflow_docs.pictures.theme import WIDTH, Drawing, Theme
from anchorflow_service.local import LocalClient

WORLD = 0
LATENCY_S = 0.1
MOMENTS = (0.05, 0.3, 0.5, 0.75)  # shares of the drive


def drive(stage: Stage) -> Drawing:
    """Draw four moments of one drive with answers 100 ms late."""
    world, ticks = draw_world(WORLD), []
    controller = MppiController(Unicycle(), MppiConfig(), tick_s=DriveConfig().tick_s)
    config = DriveConfig(options={"num_samples": 64, "sampler": QUICK})
    clock = SimulatedTime()
    planner = Planner(
        LocalClient(stage.engine),
        config.asking(controller.config.cost.margin),
        clock=clock,
        executor=LatencyExecutor(clock, fixed_s=LATENCY_S),
    )
    Drive(world, controller, planner=planner, clock=clock, config=config).run(ticks.append)
    shown = [int(share * len(ticks)) for share in MOMENTS]

    def draw(theme: Theme) -> Figure:
        figure, axes = plt.subplots(1, len(shown), figsize=(WIDTH, 4.6), layout="constrained")
        for axis, index in zip(axes, shown, strict=True):
            _draw(axis, world, ticks[: index + 1], theme)
        return figure

    return draw


def _draw(axis: Axes, world: World, ticks: list[Tick], theme: Theme) -> None:
    """Draw the last tick and the way up to it."""
    tick, plan = ticks[-1], ticks[-1].plan
    posts = [Circle((x, y), world.post_radius) for x, y in world.posts]
    axis.add_collection(PatchCollection(posts, color=theme.faint, alpha=0.5))
    rows, columns = np.nonzero(tick.occupied)
    seen = tick.origin + tick.resolution * (np.stack([columns, rows], 1) + 0.5)
    axis.plot(*seen.T, "s", color=theme.obstacle, markersize=0.8)
    if plan is not None and plan.usable and plan.on_route is not None:
        paths = plan.states()[..., :2]
        for own, colour in ((False, theme.ways[1]), (True, theme.ways[0])):
            lines = list(paths[plan.on_route == own])
            axis.add_collection(LineCollection(lines, colors=colour, linewidths=0.6))
    axis.plot(*np.array([t.pose[:2] for t in ticks]).T, color=theme.start, linewidth=2.0)
    axis.plot(*tick.ahead.T, color=theme.ink, linewidth=1.4)
    axis.add_patch(Circle((tick.pose[0], tick.pose[1]), Unicycle.radius, color=theme.start))
    axis.plot(*world.goal, "*", color=theme.goal, markersize=9)
    low, high = world.posts.min(0), np.maximum(world.posts.max(0), world.goal)
    axis.set(
        xlim=(low[0] - 0.2, high[0] + 0.2),
        ylim=(world.start[1] - 1.0, high[1] + 0.5),
        aspect="equal",
        title=f"{tick.time_s:.1f} s",
    )
    axis.set_axis_off()
