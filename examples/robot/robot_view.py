"""Draw what the robot sees and plans, in a window or as a GIF."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from PIL import Image

from anchorflow_benchmarks.closed_loop.drive import Tick
from anchorflow_benchmarks.closed_loop.worlds import World

SIZE_INCHES, DPI = (4.2, 8.4), 75
MARGIN = 1.0  # m round start, goal and posts
EVERY = 2  # ticks between two frames of a GIF
OTHER_ROUTE = "tab:olive"
PLAN_COLOR = {"fresh": "tab:green", "held": "tab:orange", "expired": "tab:red"}


class Picture:
    """A figure of one world, updated at every tick."""

    def __init__(self, figure: Figure, world: World, robot_radius: float) -> None:
        self.figure = figure
        self.axes: Axes = figure.add_subplot()
        self._way: list[np.ndarray] = []
        ends = np.stack([world.start[:2], world.goal])
        points = np.concatenate([world.posts, ends])
        low, high = points.min(0) - MARGIN, points.max(0) + MARGIN
        posts = [Circle((x, y), world.post_radius) for x, y in world.posts]
        self.axes.add_collection(PatchCollection(posts, color="0.8", zorder=1))
        self.axes.plot(*world.goal, "k*", markersize=10)
        self.axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        (self._hits,) = self.axes.plot([], [], "s", color="tab:red", markersize=2, zorder=2)
        self._anchors = LineCollection([], linewidths=0.7, zorder=3)
        self.axes.add_collection(self._anchors)
        (self._driven,) = self.axes.plot([], [], color="tab:blue", linewidth=1.5, zorder=4)
        (self._ahead,) = self.axes.plot([], [], "k-", linewidth=1.5, zorder=5)
        (self._heading,) = self.axes.plot([], [], "k-", linewidth=2, zorder=6)
        self._robot = Circle((0, 0), robot_radius, color="tab:blue", zorder=5)
        self.axes.add_patch(self._robot)

    def show(self, tick: Tick) -> None:
        """Draw posts grey, mapped cells red, and anchors in the colour of the plan's state."""
        x, y, yaw = tick.pose
        self._way.append(np.array([x, y]))
        rows, columns = np.nonzero(tick.occupied)
        cells = tick.origin + tick.resolution * (np.stack([columns, rows], 1) + 0.5)
        self._hits.set_data(*cells.T)
        self._driven.set_data(*np.array(self._way).T)
        self._ahead.set_data(*tick.ahead.T)
        self._robot.set_center((x, y))
        self._heading.set_data([x, x + 0.4 * np.cos(yaw)], [y, y + 0.4 * np.sin(yaw)])
        title = f"{tick.time_s:.1f} s"
        if tick.plan is not None:
            state = tick.plan.state.value
            paths = list(tick.plan.states()[..., :2]) if tick.plan.usable else []
            color = PLAN_COLOR.get(state, "0.5")
            self._anchors.set_segments(paths)
            own = [] if tick.plan.on_route is None else tick.plan.on_route
            self._anchors.set_color([color if same else OTHER_ROUTE for same in own] or [color])
            title += f", plan {state}" + (f", {tick.plan.age_ms:.0f} ms old" if paths else "")
        self.axes.set_title(title, fontsize=9)


class LiveView:
    """A window that follows the run."""

    def __init__(self, world: World, robot_radius: float) -> None:
        figure = plt.figure(figsize=SIZE_INCHES, layout="constrained")
        self._picture = Picture(figure, world, robot_radius)

    def __call__(self, tick: Tick) -> None:
        self._picture.show(tick)
        plt.pause(1e-3)


class Recorder:
    """Writes a GIF of the run at the end of its block."""

    def __init__(self, world: World, robot_radius: float, path: Path) -> None:
        self._path = path
        self._canvas = FigureCanvasAgg(Figure(SIZE_INCHES, DPI, layout="constrained"))
        self._picture = Picture(self._canvas.figure, world, robot_radius)
        self._frames: list[Image.Image] = []
        self._times: list[float] = []
        self._ticks = 0

    def __call__(self, tick: Tick) -> None:
        self._ticks += 1
        if self._ticks % EVERY != 1:
            return
        self._picture.show(tick)
        self._canvas.draw()
        frame = Image.fromarray(np.asarray(self._canvas.buffer_rgba())).convert("RGB")
        self._frames.append(frame.quantize(64))
        self._times.append(tick.time_s)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._frames:
            frame_ms = 1e3 * float(np.diff(self._times).mean()) if len(self._times) > 1 else 100.0
            first, *rest = self._frames
            first.save(self._path, save_all=True, append_images=rest, duration=frame_ms, loop=0)
