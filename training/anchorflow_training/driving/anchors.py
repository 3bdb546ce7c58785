"""Clusters of goals and anchors, and the PDM sub-scores of anchors in every window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anchorflow_driving.errors import UNREADABLE
from anchorflow_driving.log import DrivingLog, read_log
from anchorflow_driving.pdm import SUB_SCORES, PdmScorer, PdmScores
from anchorflow_driving.window import Scenes
from anchorflow_training.driving.labels import example
from anchorflow_training.driving.log_cache import Arrays, Progress, digest, log_arrays
from anchorflow_training.settings import ConfigError

MOST_ENDS = 20_000  # that are clustered
ITERATIONS = 30


def clustered(ends: NDArray[np.floating], *, count: int, seed: int) -> NDArray[np.float32]:
    """K centres [K, P] of ends [M, 2] m, or of points of more numbers, the nearest to 0 first."""
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(ends), min(len(ends), MOST_ENDS), replace=False)
    points = np.asarray(ends, np.float64)[chosen]
    if len(points) < count:  # too few to cluster: the same ones, a little apart
        size = count, points.shape[1]
        points = np.resize(points, size) + rng.normal(0.0, 0.5, size)
    centres = _spread(points, count, rng)
    for _ in range(ITERATIONS):
        nearest = KDTree(centres).query(points)[1]
        members = np.bincount(nearest, minlength=count)
        sums = np.stack([np.bincount(nearest, axis, count) for axis in points.T], axis=-1)
        centres = np.where(members[:, None] > 0, sums / np.maximum(members, 1)[:, None], centres)
    return centres[np.argsort(np.linalg.norm(centres, axis=1))].astype(np.float32)


def _spread(
    points: NDArray[np.float64], count: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Points to begin with [K, F], each drawn by its squared distance from those before it
    (k-means++; Arthur and Vassilvitskii, 2007)."""
    centres = [points[rng.integers(len(points))]]
    away = np.full(len(points), np.inf)
    for _ in range(count - 1):
        away = np.minimum(away, ((points - centres[-1]) ** 2).sum(1))
        total = away.sum()
        chance = away / total if total > 0 else None
        centres.append(points[rng.choice(len(points), p=chance)])
    return np.stack(centres)


Floats = NDArray[np.float32]

HEADING_M = 5.0
"""m that a radian counts for when futures are clustered."""


def examples_of(logs: Sequence[Path]) -> Floats:
    """What there is to imitate in the windows of logs: poses [M, T, 3], m and rad."""
    shown = (example(window) for log in logs for window in Scenes(read_log(log)))
    return np.array([poses for poses in shown if poses is not None], np.float32)


def trajectory_anchors(futures: NDArray[np.floating], *, count: int, seed: int) -> Floats:
    """K anchors [K, T, 3] of futures [M, T, 3], by k-means over x, y and heading.

    Raises `ConfigError` if there is none.
    """
    if not len(futures):
        raise ConfigError("anchors: expected examples to cluster, found none in any window")
    units = np.array([1.0, 1.0, HEADING_M])
    points = (futures * units).reshape(len(futures), -1)
    centres = clustered(points, count=count, seed=seed)
    return (centres.reshape(count, -1, 3) / units).astype(np.float32)


def read_points(path: Path, shape: tuple[int, ...], *, setting: str) -> Floats:
    """Return the goals or anchors of a .npy file.

    Raises `ConfigError`, naming the setting, if it is unreadable, of another shape or not finite.
    """
    try:
        points = np.load(path, allow_pickle=False)
    except UNREADABLE as error:
        raise ConfigError(f"{setting}: {path}: {error}") from error
    if points.shape != shape:
        found = [*points.shape]
        raise ConfigError(f"{setting}: {path}: expected shape {[*shape]}, got {found}")
    if points.dtype.kind not in "iuf" or not np.isfinite(points).all():
        raise ConfigError(f"{setting}: {path}: expected finite numbers, got {points.dtype}")
    return points.astype(np.float32)


GRID = "grid:"


def read_goals(told: str, count: int) -> Floats:
    """Return goals [K, 2] m of a .npy file, or a grid: `grid:X0,X1,Y0,Y1` spreads them evenly.

    Raises `ConfigError` as `read_points`, and if the grid has not four numbers that rise in pairs.
    """
    if not told.startswith(GRID):
        return read_points(Path(told), (count, 2), setting="vocabulary")
    try:
        low_x, high_x, low_y, high_y = map(float, told.removeprefix(GRID).split(","))
    except ValueError:
        low_x = high_x = low_y = high_y = np.nan
    if not (low_x < high_x and low_y < high_y):
        raise ConfigError(f"vocabulary: expected {GRID}X0,X1,Y0,Y1 in m, each rising, got {told}")
    across = max(1, round((count * (high_y - low_y) / (high_x - low_x)) ** 0.5))
    x, y = np.linspace(low_x, high_x, -(-count // across)), np.linspace(low_y, high_y, across)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)[:count]
    return points.astype(np.float32)


def anchor_scores(
    logs: Sequence[Path], anchors: Floats, *, progress: Progress = lambda *_: None
) -> Floats:
    """PDM sub-scores [W, K, 5] of anchors in all windows of logs, in the order of SUB_SCORES.

    Those of each log are worked out once, on every core, and kept beside it under the anchors'
    digest. Raises `LogError` where a log or what is kept of it cannot be read, or there is no place
    to write beside it.
    """
    make = partial(_scored, anchors=anchors)
    parts = log_arrays(logs, f".pdm-{digest(anchors)}", make, progress=progress)
    return np.concatenate([part["scores"].astype(np.float32) for part in parts])


def read_scores(
    folder: Path, logs: Sequence[Path], counts: Sequence[int], anchors: int, *, suffix: str = ""
) -> Floats:
    """Sub-scores [W, K, 5] of a folder: LOG.npy [w, K, 5] for each log, by its name and suffix.

    counts: windows of each log

    Raises `ConfigError` if a file is missing, of another shape, or not from 0 to 1.
    """
    parts = []
    for log, count in zip(logs, counts, strict=True):
        file = folder / f"{log.stem}{suffix}.npy"
        part = read_points(file, (count, anchors, len(SUB_SCORES)), setting="rewards")
        if part.size and not 0 <= part.min() <= part.max() <= 1:
            raise ConfigError(f"rewards: {file}: expected 0 to 1, got {part.min()} to {part.max()}")
        parts.append(part)
    return np.concatenate(parts)


def read_token_scores(
    file: Path, logs: Sequence[Path], anchors: int, *, suffix: str = ""
) -> Floats:
    """Sub-scores [W, K, 5] of an .npz: an array [K, 5] for each window, by the token of its frame.

    Raises `ConfigError` if the file is unreadable, a log has no tokens, an array is missing, of
    another shape, or not from 0 to 1.
    """
    try:
        with np.load(file, allow_pickle=False) as table:
            return np.array(
                [
                    _of_token(table, f"{token}{suffix}", anchors, file)
                    for log in logs
                    for token in _window_tokens(read_log(log))
                ],
                np.float32,
            ).reshape(-1, anchors, len(SUB_SCORES))
    except UNREADABLE as error:
        raise ConfigError(f"rewards: {file}: {error}") from error


def _window_tokens(log: DrivingLog) -> list[str]:
    if log.frame_token is None:
        expected = "logs with tokens of their frames, as data import-log writes them"
        raise ConfigError(f"rewards: expected {expected}, got {log.path} without")
    return log.frame_token[log.window_frame].tolist()


def _of_token(table: Mapping[str, Floats], token: str, anchors: int, file: Path) -> Floats:
    if token not in table:
        raise ConfigError(f"rewards: {file}: expected an array {token!r}, got none")
    part, shape = table[token], (anchors, len(SUB_SCORES))
    if part.shape != shape or not (part >= 0).all() or not (part <= 1).all():
        found = f"{[*part.shape]}" if part.shape != shape else f"{part.min()} to {part.max()}"
        raise ConfigError(f"rewards: {file}: {token}: expected {[*shape]} of 0 to 1, got {found}")
    return part


def _scored(log: Path, *, anchors: Floats) -> Arrays:
    plans = anchors.astype(np.float64)
    rows = [PdmScorer(window).score(plans).sub_scores for window in Scenes(read_log(log))]
    table = np.array(rows, np.float16).reshape(-1, len(anchors), len(SUB_SCORES))
    return {"scores": table}


def pdms(scores: NDArray[np.floating]) -> NDArray[np.floating]:
    """PDMS [...] of sub-scores [..., 5]."""
    return PdmScores(*np.moveaxis(scores, -1, 0)).pdms
