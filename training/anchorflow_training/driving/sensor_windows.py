"""Windows of driving logs with recorded or simulated sensors, kept compressed beside the logs."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import TensorSpec
from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.log import DRIVEN, read_log
from anchorflow_driving.sensors.agents import far_others, nearest_agents
from anchorflow_driving.sensors.bev import DRAWING
from anchorflow_driving.sensors.inputs import draw_inputs
from anchorflow_driving.sensors.lidar import simulated_lidar_before
from anchorflow_driving.window import Scenes, Window
from anchorflow_models.transfuser import LIDAR_BEFORE, SEMANTIC_STRIDE, TransfuserConfig
from anchorflow_training.batches import Batch, reflection
from anchorflow_training.driving.augmentation import mirrored_status
from anchorflow_training.driving.labels import (
    example,
    occupancy,
    randomised_motion,
    semantic_bev,
    view_after,
)
from anchorflow_training.driving.log_cache import Progress, log_arrays, no_windows

KEPT = f".sensors-{DRAWING}"
"""Suffix of the cache of sensors beside a log."""
LEVEL = 3  # of zlib
COUNTS = 5  # points in a LiDAR cell that make 1
SWEEPS = ("lidar", LIDAR_BEFORE)
LIDAR_RANDOMISED = "lidar_randomised"
"""The earlier sweep, had the others moved as chance has it."""
INPUTS = ("camera", *SWEEPS, "ego_status")
BOXES = ("agents", "far_others")
VELOCITIES = ("agent_velocity", "randomised_velocity", "far_velocity")
NUMBERS = (
    "ego_status",
    "future",
    "is_example",
    "is_recorded",
    *BOXES,
    *VELOCITIES,
    "agent_count",
    "far_count",
)

Drawn = dict[str, NDArray[Any]]
Value = TypeVar("Value")


@dataclass(frozen=True)
class SensorSizes:
    """Of the camera's picture, of the LiDAR's histogram (cells a side) and its range, m.

    lidar_before: whether there is an earlier sweep beside
    """

    camera_rows: int
    camera_columns: int
    lidar_size: int
    lidar_range: float
    lidar_before: bool = False

    @classmethod
    def of(cls, backbone: TransfuserConfig) -> SensorSizes:
        """Return the sizes of a backbone's inputs."""
        return cls(
            backbone.image_height,
            backbone.image_width,
            backbone.lidar_size,
            backbone.lidar_range,
            backbone.lidar_before,
        )

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The shape of each picture."""
        semantic = (self.lidar_size // 2, self.lidar_size)
        return {
            "camera": (3, self.camera_rows, self.camera_columns),
            **dict.fromkeys(self.histograms, (1, self.lidar_size, self.lidar_size)),
            "semantics": semantic,
            "future_semantics": semantic,
            "occupancy": (len(PLAN_TIMES), self.cells, self.cells),
        }

    @property
    def sweeps(self) -> tuple[str, ...]:
        """Names of the LiDAR's histograms."""
        return SWEEPS if self.lidar_before else SWEEPS[:1]

    @property
    def histograms(self) -> tuple[str, ...]:
        """The sweeps, and the one with randomised motion."""
        return (*SWEEPS, LIDAR_RANDOMISED) if self.lidar_before else self.sweeps

    @property
    def cells(self) -> int:
        """Cells a side of the occupancy."""
        return self.lidar_size // SEMANTIC_STRIDE

    @property
    def inputs(self) -> tuple[TensorSpec, ...]:
        """The inputs to simulate, as a planner's card lists them."""
        shapes = self.shapes
        return (
            TensorSpec("camera", "uint8", ("B", *shapes["camera"])),
            *(TensorSpec(name, "float32", ("B", *shapes[name])) for name in self.sweeps),
            TensorSpec("ego_status", "float32", ("B", 8)),
        )


@dataclass(frozen=True, eq=False)
class SensorWindows:
    """W windows, those of a log beside one another.

    streams: zlib, one a window: the pictures of `sizes.shapes` as bytes, the LiDAR as counts
    numbers: ego_status [W, 8]; future [W, T, 3] poses to imitate, m and rad, where is_example [W]
        is 1; is_recorded [W]: whether they are those that were driven;
        agents [W, Q, 5] x, y, heading, length, width, the first agent_count [W] of which are there;
        agent_velocity [W, Q, 2] theirs, m/s forward and to the left; randomised_velocity, had they
        moved as chance has it; far_others, far_velocity, far_count: likewise of those far ahead
    logs: the files; log: [W] which of them
    """

    streams: Sequence[bytes]
    numbers: Drawn
    log: NDArray[np.int64]
    logs: Sequence[Path]
    sizes: SensorSizes

    def __len__(self) -> int:
        return len(self.log)

    def batch(self, windows: NDArray[np.integer], *, mirrored: bool = False) -> Batch:
        """Return sensors and labels of these windows, or of their reflections."""
        pictures = [self._pictures(int(window)) for window in windows]
        drawn = {n: np.stack([each[n] for each in pictures]) for n in self.sizes.shapes}
        drawn |= {name: drawn[name].astype(np.float32) / COUNTS for name in self.sizes.histograms}
        seen = drawn | {name: array[windows] for name, array in self.numbers.items()}
        return reflected(seen, pictures=tuple(drawn)) if mirrored else seen

    def _pictures(self, window: int) -> Drawn:
        data = np.frombuffer(zlib.decompress(self.streams[window]), np.uint8)
        shapes = self.sizes.shapes
        ends = np.cumsum([np.prod(shape) for shape in shapes.values()])
        parts = np.split(data, ends[:-1])
        return {n: part.reshape(shapes[n]) for n, part in zip(shapes, parts, strict=True)}


def sensors_of(batch: Mapping[str, Value]) -> dict[str, Value]:
    """Return the network's inputs in a batch."""
    return {name: batch[name] for name in INPUTS if name in batch}


def reflected(batch: Batch, *, pictures: Sequence[str]) -> Batch:
    """A batch as it would be, were left right; pictures: by which names it has some."""
    turned = {name: np.ascontiguousarray(batch[name][..., ::-1]) for name in pictures}
    signs = reflection(3)
    boxes = np.concatenate([signs, np.ones(batch["agents"].shape[-1] - 3, np.float32)])
    return {
        **batch,
        **turned,
        "ego_status": mirrored_status(batch["ego_status"]),
        "future": batch["future"] * signs,
        **{name: batch[name] * boxes for name in BOXES},
        **{name: batch[name] * signs[:2] for name in VELOCITIES},
    }


def open_sensor_windows(
    logs: Sequence[Path],
    sizes: SensorSizes,
    *,
    draw: Callable[[Window, SensorSizes], Drawn] | None = None,
    progress: Progress = lambda *_: None,
) -> SensorWindows:
    """The windows of logs; those of each log are drawn once, on every core, and kept beside it.

    draw: the arrays of a window, named in `sizes.shapes` and NUMBERS; by default `sensed`

    Raises `LogError` if a log or what is kept of it cannot be read, there is no place to write
    beside it, or none has a window.
    """
    layout = list(asdict(sizes).values())
    parts = log_arrays(
        logs,
        KEPT,
        partial(_drawn, sizes=sizes, draw=draw or sensed),
        is_current=lambda part: (
            set(NUMBERS) <= set(part) and np.array_equal(part["layout"], layout)
        ),
        progress=progress,
    )
    streams: list[bytes] = []
    rows: dict[str, list[NDArray[Any]]] = {name: [] for name in NUMBERS}
    counts = []
    for part in parts:
        ends = part["sizes"].cumsum()
        pictures = np.split(part["pictures"], ends[:-1]) if len(ends) else []
        streams += (picture.tobytes() for picture in pictures)
        counts.append(len(ends))
        if len(ends):  # a log without windows has no rows, not even of a shape
            for name in NUMBERS:
                rows[name].append(part[name])
    if not streams:
        raise no_windows(logs[0].parent)
    numbers = {name: np.concatenate(rows[name]) for name in NUMBERS}
    return SensorWindows(streams, numbers, np.repeat(np.arange(len(logs)), counts), logs, sizes)


def _drawn(log: Path, *, sizes: SensorSizes, draw: Callable[[Window, SensorSizes], Drawn]) -> Drawn:
    rows = [draw(window, sizes) for window in Scenes(read_log(log))]
    streams = [
        zlib.compress(b"".join(row[n].astype(np.uint8).tobytes() for n in sizes.shapes), LEVEL)
        for row in rows
    ]
    return {
        "pictures": np.frombuffer(b"".join(streams), np.uint8),
        "sizes": np.array([len(stream) for stream in streams], np.int64),
        "layout": np.array(list(asdict(sizes).values())),
        **{name: np.array([row[name] for row in rows]) for name in NUMBERS},
    }


def sensed(window: Window, sizes: SensorSizes) -> Drawn:
    """By the recorded camera and LiDAR or, if the log has none, by simulated ones.

    Chance moves others in simulated sweeps alone. Raises what the sensors raise.
    """
    view, shown = window.view, example(window)
    future = np.zeros((len(PLAN_TIMES), 3)) if shown is None else shown
    seen = draw_inputs(view, sizes.inputs)
    agents, velocity, there = nearest_agents(view)
    far, far_velocity, far_there = far_others(view)
    is_simulated = view.sensors is None
    chance = randomised_motion(view) if is_simulated else view
    if sizes.lidar_before:
        before = simulated_lidar_before(chance) if is_simulated else seen[LIDAR_BEFORE]
        seen[LIDAR_RANDOMISED] = before
    rows, reach = sizes.lidar_size // 2, sizes.lidar_range
    return {
        "camera": seen["camera"],
        **{name: np.rint(COUNTS * seen[name]).astype(np.uint8) for name in sizes.histograms},
        "semantics": semantic_bev(view, rows=rows, reach=reach),
        "future_semantics": semantic_bev(
            view_after(window, float(PLAN_TIMES[-1])), rows=rows, reach=reach
        ),
        "occupancy": occupancy(window, cells=sizes.cells, reach=reach),
        "ego_status": seen["ego_status"],
        "future": future.astype(np.float32),
        "is_example": np.array(shown is not None, np.float32),
        "is_recorded": np.array(window.log.source != DRIVEN, np.float32),
        "agents": agents,
        "agent_velocity": velocity,
        "randomised_velocity": nearest_agents(chance)[1],
        "agent_count": np.array(there.sum()),
        "far_others": far,
        "far_velocity": far_velocity,
        "far_count": np.array(far_there.sum()),
    }


GAIN, TINT, GRAIN = 0.15, 12.0, 8.0
"""Spread of brightness and colours; of what a colour is off by; at most, of single pixels."""
LOST = 0.3  # at most, of the cells of a sweep


def disturb(batch: Batch, rng: np.random.Generator, *, scale: float) -> None:
    """Change camera [B, 3, H, W] and sweeps [B, 1, H', H'] in place, each scene's by a luck of its
    own.

    scale: of the spreads and shares above
    """
    camera = batch["camera"]
    count = len(camera)
    by_colour = (count, 3, 1, 1)
    gain = 1 + scale * GAIN * (
        rng.standard_normal((count, 1, 1, 1))
        + rng.random((count, 1, 1, 1)) * rng.standard_normal(by_colour)
    )
    grain = scale * GRAIN * rng.random((count, 1, 1, 1), np.float32)
    seen = camera * gain + scale * TINT * rng.standard_normal(by_colour)
    seen += grain * rng.standard_normal(camera.shape, np.float32)
    batch["camera"] = np.rint(seen).clip(0, 255).astype(np.uint8)
    lost = min(1.0, scale * LOST) * rng.random((count, 1, 1, 1), np.float32)
    for name in (*SWEEPS, LIDAR_RANDOMISED):
        if name in batch:
            batch[name] = batch[name] * (rng.random(batch[name].shape, np.float32) >= lost)
