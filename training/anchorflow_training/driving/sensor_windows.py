"""Windows of driving logs with simulated sensors, kept compressed beside the logs."""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import TensorSpec
from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.errors import LogError
from anchorflow_driving.log import read_log
from anchorflow_driving.sensors.agents import nearest_agents
from anchorflow_driving.sensors.by_name import draw_inputs
from anchorflow_driving.window import Scenes, Window
from anchorflow_models.transfuser import TransfuserConfig
from anchorflow_training.batches import Batch
from anchorflow_training.driving.augmentation import mirrored_status
from anchorflow_training.driving.semantic_bev import semantic_bev, view_after
from anchorflow_training.reflection import reflection

KEPT = ".sensors"
"""Suffix of the file beside a log that holds what its sensors tell."""
LEVEL = 3  # of zlib
COUNTS = 5  # points in a LiDAR cell that make 1
PICTURES = ("camera", "lidar", "semantics", "future_semantics")
NUMBERS = ("ego_status", "future", "agents", "agent_count")

Progress = Callable[[int, int], None]
"""Told how many of how many logs are done."""
Drawn = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class SensorSizes:
    """Of the camera's picture, of the LiDAR's histogram (cells a side) and its range, m."""

    camera_rows: int
    camera_columns: int
    lidar_size: int
    lidar_range: float

    @classmethod
    def of(cls, backbone: TransfuserConfig) -> SensorSizes:
        """Of what a backbone looks at."""
        return cls(
            backbone.image_height, backbone.image_width, backbone.lidar_size, backbone.lidar_range
        )

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Of each picture."""
        semantic = (self.lidar_size // 2, self.lidar_size)
        return {
            "camera": (3, self.camera_rows, self.camera_columns),
            "lidar": (1, self.lidar_size, self.lidar_size),
            "semantics": semantic,
            "future_semantics": semantic,
        }

    @property
    def inputs(self) -> tuple[TensorSpec, ...]:
        """What the sensors are asked for, as by a planner's card."""
        shapes = self.shapes
        return (
            TensorSpec("camera", "uint8", ("B", *shapes["camera"])),
            TensorSpec("lidar", "float32", ("B", *shapes["lidar"])),
            TensorSpec("ego_status", "float32", ("B", 8)),
        )


@dataclass(frozen=True, eq=False)
class SensorWindows:
    """W windows, those of a log beside one another.

    streams: zlib, one a window: its PICTURES as bytes, the LiDAR as counts
    numbers: ego_status [W, 8]; future [W, T, 3] poses that were driven, m and rad;
        agents [W, Q, 5] x, y, heading, length, width, the first agent_count [W] of which are there
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
        """What sensors tell of these windows, or of their reflections, and what is to be learnt."""
        pictures = [self._pictures(int(window)) for window in windows]
        drawn = {name: np.stack([each[name] for each in pictures]) for name in PICTURES}
        drawn["lidar"] = drawn["lidar"].astype(np.float32) / COUNTS
        seen = drawn | {name: array[windows] for name, array in self.numbers.items()}
        return reflected(seen) if mirrored else seen

    def _pictures(self, window: int) -> Drawn:
        data = np.frombuffer(zlib.decompress(self.streams[window]), np.uint8)
        shapes = self.sizes.shapes
        ends = np.cumsum([np.prod(shapes[name]) for name in PICTURES])
        parts = np.split(data, ends[:-1])
        return {n: part.reshape(shapes[n]) for n, part in zip(PICTURES, parts, strict=True)}


def reflected(batch: Batch) -> Batch:
    """A batch as it would be, were left right."""
    pictures = {name: np.ascontiguousarray(batch[name][..., ::-1]) for name in PICTURES}
    signs = reflection(3)
    boxes = np.concatenate([signs, np.ones(batch["agents"].shape[-1] - 3, np.float32)])
    return {
        **batch,
        **pictures,
        "ego_status": mirrored_status(batch["ego_status"]),
        "future": batch["future"] * signs,
        "agents": batch["agents"] * boxes,
    }


def open_logs(folder: Path) -> Sequence[Path]:
    """The logs of a folder. Raises `LogError` where there are none."""
    logs = sorted(folder.glob("*.npz"))
    if not logs:
        raise LogError(folder, "folder", expected="logs (*.npz)", found="none")
    return logs


def open_sensor_windows(
    logs: Sequence[Path],
    sizes: SensorSizes,
    *,
    draw: Callable[[Window, SensorSizes], Drawn] | None = None,
    progress: Progress = lambda *_: None,
) -> SensorWindows:
    """The windows of logs; those of each log are drawn once, on every core, and kept beside it.

    draw: what the sensors tell of a window, by the names of PICTURES and NUMBERS; by default by
        the simulated camera and LiDAR

    Raises:
        LogError: a log cannot be read, or there is no place to write beside it.
    """
    missing = [log for log in logs if not _is_kept(log, sizes)]
    keep = partial(keep_sensors, sizes=sizes, draw=draw or simulated)
    each_log(keep, missing, of=len(logs), progress=progress)
    parts = [np.load(log.with_suffix(KEPT), allow_pickle=False) for log in logs]
    streams = [
        part["pictures"][begin : begin + size].tobytes()
        for part in parts
        for begin, size in zip(_begins(part["sizes"]), part["sizes"], strict=True)
    ]
    counts = [len(part["sizes"]) for part in parts]
    numbers = {name: np.concatenate([part[name] for part in parts]) for name in NUMBERS}
    return SensorWindows(streams, numbers, np.repeat(np.arange(len(logs)), counts), logs, sizes)


def each_log(
    keep: Callable[[Path], None], logs: Sequence[Path], *, of: int, progress: Progress
) -> None:
    """Do something with every log, on every core; what is done stays done if it is cut off."""
    progress(of - len(logs), of)
    if not logs:
        return
    with ProcessPoolExecutor(min(len(logs), os.cpu_count() or 1)) as pool:
        for done, _ in enumerate(pool.map(keep, logs), start=of - len(logs) + 1):
            progress(done, of)


def keep_sensors(
    log: Path, *, sizes: SensorSizes, draw: Callable[[Window, SensorSizes], Drawn]
) -> None:
    """Draw what the sensors tell of a log's windows, and keep it beside the log."""
    rows = [draw(window, sizes) for window in Scenes(read_log(log))]
    streams = [
        zlib.compress(b"".join(row[name].astype(np.uint8).tobytes() for name in PICTURES), LEVEL)
        for row in rows
    ]
    arrays = {name: np.array([row[name] for row in rows]) for name in NUMBERS}
    write_beside(
        log.with_suffix(KEPT),
        pictures=np.frombuffer(b"".join(streams), np.uint8),
        sizes=np.array([len(stream) for stream in streams], np.int64),
        layout=np.array(list(asdict(sizes).values())),
        **arrays,
    )


def write_beside(path: Path, **arrays: NDArray[Any]) -> None:
    """Write arrays whole or not at all; raises `LogError` where there is no place to write."""
    scratch = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        with scratch.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]
        scratch.replace(path)
    except OSError as error:
        raise LogError(path, "file", expected="a place to write", found=str(error)) from error


def simulated(window: Window, sizes: SensorSizes) -> Drawn:
    """By the simulated camera and LiDAR. Raises what they raise where nothing can be drawn."""
    view = window.view
    seen = draw_inputs(view, sizes.inputs)
    agents, there = nearest_agents(view)
    rows, reach = sizes.lidar_size // 2, sizes.lidar_range
    return {
        "camera": seen["camera"],
        "lidar": np.rint(COUNTS * seen["lidar"]).astype(np.uint8),
        "semantics": semantic_bev(view, rows=rows, reach=reach),
        "future_semantics": semantic_bev(
            view_after(window, float(PLAN_TIMES[-1])), rows=rows, reach=reach
        ),
        "ego_status": seen["ego_status"],
        "future": window.recorded(PLAN_TIMES).astype(np.float32),
        "agents": agents,
        "agent_count": np.array(there.sum()),
    }


def _is_kept(log: Path, sizes: SensorSizes) -> bool:
    """Whether a log's windows are there, of these sizes, and drawn of the log as it is."""
    kept = log.with_suffix(KEPT)
    if not kept.exists() or kept.stat().st_mtime < log.stat().st_mtime:
        return False
    with np.load(kept, allow_pickle=False) as file:
        return np.array_equal(file["layout"], list(asdict(sizes).values()))


def _begins(sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate([[0], sizes.cumsum()[:-1]])
