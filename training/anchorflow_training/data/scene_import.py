"""Import a trajectory file as a scene dataset: each sample becomes a scene with one trajectory."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.data.statistics import FIELDS, HEADING
from anchorflow_training.data.trajectory_dataset import TrajectoryDataset
from anchorflow_training.dataset import (
    DatasetError,
    Row,
    create_arrays,
    scene_row,
    shrink_arrays,
    write_meta,
)
from anchorflow_training.make_data import mapper
from anchorflow_trajectory.finish.certificate import path_clearance
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline.basis import GOAL_POINTS, START_POINTS, SplineBasis, spline_basis
from anchorflow_trajectory.warm_start import nearest_route

FloatArray = NDArray[np.floating]

STYLE = (0.4, 0.3, 0.3)  # safety, energy, smooth, for a file without style_weights
REACHED = 0.1  # m from a given end to the trajectory's own
LEAST_POINTS = START_POINTS + GOAL_POINTS + 1
ROOM_SHARE, ROOM_M = 0.75, 3.0
"""Half the side of an empty map, in shares of what the trajectory spans, and metres beside it.

The network looks at a square around start and goal, and beyond a map's edge the robot may not be.
"""


@dataclass(frozen=True)
class SceneOptions:
    """How a sample becomes a scene.

    robot_radius: m; cells: H = W of the empty map of a sample that has none
    keep_collisions: keep samples that touch an obstacle or come nearer than their safety margin
    """

    robot_radius: float = 0.25
    cells: int = 64
    keep_collisions: bool = False


@dataclass(frozen=True)
class SceneSource:
    """One sample: its arrays without the N axis, its map's (origin x, origin y, resolution).

    duration: s that it lasts
    motion: limits of the scene; without a horizon the sample chose its own duration
    """

    arrays: Mapping[str, FloatArray]
    geometry: NDArray[np.float64] | None
    duration: float
    motion: MotionLimits
    options: SceneOptions


def imported_scene(source: SceneSource) -> Row | str:
    """The scene's arrays as `SceneDataset` keeps them, or why the sample is left out."""
    arrays, options = source.arrays, source.options
    fields = [arrays[name] for name in FIELDS]
    x_curr, x_goal = end_states(arrays)
    for state, position in zip((x_curr, x_goal), fields[0][[0, -1]], strict=True):
        if np.linalg.norm(state[:2] - position[:2]) > REACHED:
            return "missed_ends"
    if source.geometry is None:
        given, origin, resolution, centre = empty_map(fields[0], x_curr, x_goal, options.cells)
        # The position of an empty map is free; near the origin float32 is most exact.
        fields[0] = fields[0] - centre
        x_curr, x_goal = (_moved(x, -centre) for x in (x_curr, x_goal))
    else:
        *corner, resolution = source.geometry.tolist()
        given, origin = arrays["cost_maps"], np.array(corner)
    style = np.asarray(arrays.get("style_weights", STYLE))
    scene = Scene(
        cost_map=given,
        resolution=resolution,
        origin=origin,
        robot_radius=options.robot_radius,
        x_curr=x_curr,
        x_goal=x_goal,
        w_style=style / style.sum(),
        motion=source.motion,
        basis=_basis(len(fields[0])),
    )
    if not all(scene.is_free(x[:2]) for x in (x_curr, x_goal)):
        return "off_map"
    if not options.keep_collisions:
        margin = float(arrays.get("safety_margins", np.zeros(())))
        positions = fields[0].astype(np.float32)[None]
        clearance = path_clearance(scene.cost_fields.clearance, positions)
        if clearance[0] < margin:
            return "collision"
    route = nearest_route(scene.route_states, fields[0])
    row = scene_row(
        scene,
        np.concatenate(fields, -1)[None],
        durations=np.array([source.duration]),
        route=np.array([route]),
    )
    if "quality" in arrays:
        row["quality"] = arrays["quality"].astype(np.float32).reshape(1)
    return row


def end_states(arrays: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """x_curr [3D] and x_goal [2D]: as the file gives them, else the trajectory's own ends."""
    p, v, a = (arrays[name] for name in FIELDS)
    x_curr = arrays.get("start_states", np.concatenate([p[0], v[0], a[0]]))
    x_goal = arrays.get("goal_states", np.concatenate([p[-1], v[-1]]))
    return _turned_on(x_curr, p[0]), _turned_on(x_goal, p[-1])


def empty_map(
    positions: FloatArray, x_curr: FloatArray, x_goal: FloatArray, cells: int
) -> tuple[FloatArray, NDArray[np.float64], float, FloatArray]:
    """Free ground around a trajectory [T, D]: map [1, H, W], origin, resolution, and its centre.

    The origin is for positions less the centre [D], which has no heading.
    """
    points = np.concatenate([positions[:, :2], x_curr[None, :2], x_goal[None, :2]])
    low, high = points.min(0), points.max(0)
    half = ROOM_SHARE * float((high - low).max()) + ROOM_M
    centre = np.zeros(positions.shape[1])
    centre[:2] = 0.5 * (low + high)
    return np.zeros((1, cells, cells)), np.full(2, -half), 2 * half / cells, centre


def _basis(num_steps: int) -> SplineBasis:
    """As a model's by default, with fewer control points where there are fewer steps."""
    usual = spline_basis(num_steps).num_control_points
    return spline_basis(num_steps, num_control_points=min(usual, max(num_steps, LEAST_POINTS)))


def _turned_on(state: FloatArray, end: FloatArray) -> FloatArray:
    """The state, its heading, if there is one, by whole turns nearest to that of the end [D]."""
    state = state.copy()
    turn = 2 * np.pi
    state[HEADING : len(end)] += turn * np.round((end - state[: len(end)])[HEADING:] / turn)
    return state


def _moved(state: FloatArray, by: FloatArray) -> FloatArray:
    moved = state.copy()
    moved[: len(by)] += by
    return moved


LIMIT_QUANTILE = 0.995  # of the samples' peaks; a single glitch must not set the limit
LIMIT_RESERVE = 1.02
LISTED_ROWS = 100
BLOCK = 64  # samples that are read together, for each worker


@dataclass(frozen=True)
class ImportConfig:
    """Import settings that a file lacks.

    v_max, a_max: m/s and m/s^2; by default what nearly all samples keep, rounded up
    least_quality: samples with less are left out
    scene: how a sample becomes a scene

    Raises `DatasetError` if a value is out of its range.
    """

    v_max: float | None = None
    a_max: float | None = None
    least_quality: float = 0.0
    scene: SceneOptions = field(default_factory=SceneOptions)

    def __post_init__(self) -> None:
        for name in ("v_max", "a_max"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise DatasetError(f"{name}: expected a finite number above 0, got {value}")
        if not 0 <= self.least_quality <= 1:
            raise DatasetError(f"least_quality: expected 0 to 1, got {self.least_quality}")
        if not 0 <= self.scene.robot_radius < np.inf:
            raise DatasetError(
                f"robot_radius: expected a finite number of at least 0, "
                f"got {self.scene.robot_radius}"
            )


def limits_of(dataset: TrajectoryDataset, config: ImportConfig) -> MotionLimits:
    """Speed and acceleration that the samples keep, and the horizon that they share, if any.

    Raises `DatasetError` if neither the file nor the caller says how long a trajectory takes.
    """
    if dataset.durations is None:
        raise DatasetError(
            f"{dataset.path}: horizon_s: expected how long a trajectory takes, or dt, in s "
            "(--horizon-s, --dt), found neither"
        )
    v_max, a_max = (
        rounded_up(float(np.quantile(peaks, LIMIT_QUANTILE))) if given is None else given
        for given, peaks in (
            (config.v_max, dataset.peak_speed),
            (config.a_max, dataset.peak_acceleration),
        )
    )
    return MotionLimits(v_max=v_max, a_max=a_max, horizon_s=dataset.horizon_s)


def rounded_up(value: float) -> float:
    """A little more than `value`, in two digits."""
    value = max(LIMIT_RESERVE * value, 1e-3)
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.ceil(value / unit - 1e-9) * unit:.6g}")


PICTURES = ("images", "image", "scene_images", "rgb")


def import_scenes(
    dataset: TrajectoryDataset,
    out: Path,
    config: ImportConfig | None = None,
    *,
    workers: int = 1,
    progress: Callable[[int], None] = lambda _: None,
) -> dict[str, Any]:
    """Write the folder that the trainer reads, return its `dataset.json`.

    Samples that miss a given start or goal, that are off their map, that touch an obstacle of it or
    that come nearer than their safety margin are left out and counted; `progress` gets 1 a sample.

    Raises `DatasetError` if the file says too little, nothing is left of it, it has pictures, or
    `out` cannot be written.
    """
    config = config or ImportConfig()
    for name in set(dataset.ignored) & set(PICTURES):
        raise DatasetError(
            f"{dataset.path}: {name}: expected no pictures, which would be ignored: the condition "
            "is a cost map; add what they show to cost_maps as channels, or leave them out"
        )
    limits = limits_of(dataset, config)
    if not dataset.peak_speed.any():
        raise DatasetError(
            f"{dataset.path}: positions: expected a sample that moves, found {len(dataset)} that "
            "stand still"
        )
    left_out: Counter[str] = Counter(not_finite=len(dataset.left_out))
    left_out.update(missed_ends=0, off_map=0, collision=0, low_quality=0)
    arrays, written = None, 0
    with mapper(workers) as mapped:
        for sources in _sources(dataset, config, limits, left_out, BLOCK * workers, progress):
            for scene in mapped(imported_scene, sources):
                if isinstance(scene, str):
                    left_out[scene] += 1
                    continue
                if arrays is None:
                    shapes = {name: (len(dataset), *row.shape) for name, row in scene.items()}
                    arrays = create_arrays(out, shapes)
                for name, row in scene.items():
                    arrays[name][written] = row
                written += 1
    if arrays is None:
        raise DatasetError(f"{dataset.path}: no sample is left to train on: {dict(left_out)}")
    if "quality" in arrays and not arrays["quality"][:written].any():
        raise DatasetError(
            f"{dataset.path}: quality: expected more than 0 in some of the {written} samples that "
            "are left, found 0 in all: none would count in the loss"
        )
    map_shape = arrays["cost_map"].shape[1:]
    del arrays
    shrink_arrays(out, written)
    meta = {
        "format": 1,
        "scenes": written,
        "trajectories": 1,
        "robot_radius": config.scene.robot_radius,
        "map": dict(zip(("channels", "H", "W"), map_shape, strict=True)),
        "families": {dataset.path.stem: written},
        "left_out": dict(left_out),
        **_told(dataset, limits),
    }
    write_meta(out, meta)
    return meta


def _sources(
    dataset: TrajectoryDataset,
    config: ImportConfig,
    limits: MotionLimits,
    left_out: Counter[str],
    size: int,
    progress: Callable[[int], None],
) -> Iterator[list[SceneSource]]:
    """Blocks of at most `size` samples of sufficient quality."""
    durations = dataset.durations
    assert durations is not None  # as limits_of checked
    for start in range(0, len(dataset), size):
        samples = np.arange(start, min(start + size, len(dataset)))
        block = dataset.samples(samples, np.float64)
        geometry = dataset.map_geometry(samples)
        if "cost_maps" in block and geometry is None:
            raise DatasetError(
                f"{dataset.path}: resolution: expected m/cell of the cost maps, [] or [N] "
                "(--resolution), found none"
            )
        if config.least_quality and "quality" not in block:
            raise DatasetError(
                f"{dataset.path}: quality: expected an array [N] to hold --least-quality against, "
                "found none"
            )
        good = block.get("quality", np.ones(len(samples))) >= config.least_quality
        left_out["low_quality"] += int((~good).sum())
        yield [
            SceneSource(
                arrays={name: values[i] for name, values in block.items()},
                geometry=None if geometry is None else geometry[i],
                duration=float(durations[samples[i]]),
                motion=_asked(limits, int(samples[i]), durations),
                options=config.scene,
            )
            for i in np.flatnonzero(good)
        ]
        progress(len(samples))


def _told(dataset: TrajectoryDataset, limits: MotionLimits) -> dict[str, Any]:
    """Return the entries of `dataset.json` about the file and its samples."""
    return {
        "num_steps": dataset.num_steps,
        "dim": dataset.dim,
        "limits": asdict(limits),
        "ranges": _ranges(dataset),
        "source": _source_file(dataset.path),
        "not_finite_rows": dataset.left_out[:LISTED_ROWS].tolist(),
        "over_limits": _over_limits(dataset, limits),
        "statistics": dataset.statistics.to_dict(),
    }


def _asked(limits: MotionLimits, sample: int, durations: NDArray[np.float64]) -> MotionLimits:
    """Return the limits of a sample's scene.

    If durations differ, every other scene fixes its own, so that a model learns to choose
    a duration and to keep a given one.
    """
    if limits.horizon_s is not None or sample % 2 == 0:
        return limits
    return replace(limits, horizon_s=float(durations[sample]))


def _ranges(dataset: TrajectoryDataset) -> dict[str, tuple[float, float]]:
    """The limits that samples differ in, with the least and the greatest."""
    durations = dataset.durations
    if durations is None or dataset.horizon_s is not None:
        return {}
    return {"horizon_s": (float(durations.min()), float(durations.max()))}


def _over_limits(dataset: TrajectoryDataset, limits: MotionLimits) -> int:
    """How many samples do not keep the limits."""
    over = (dataset.peak_speed > limits.v_max) | (dataset.peak_acceleration > limits.a_max)
    return int(over.sum())


def _source_file(path: Path) -> dict[str, str]:
    if not path.exists():  # a synthetic dataset has no file
        return {"file": path.name}
    with path.open("rb") as stream:
        return {"file": path.name, "sha256": _sha256(stream)}


def _sha256(stream: Any) -> str:
    digest = hashlib.sha256()
    while block := stream.read(1 << 20):
        digest.update(block)
    return digest.hexdigest()
