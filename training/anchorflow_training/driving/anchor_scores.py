"""Anchors clustered from examples, and the PDM sub-scores of each in every window."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.errors import UNREADABLE
from anchorflow_driving.log import read_log
from anchorflow_driving.pdm import SUB_SCORES, PdmScorer, PdmScores
from anchorflow_driving.window import Scenes
from anchorflow_training.driving.examples import example
from anchorflow_training.driving.kept_logs import (
    DIGITS,
    Progress,
    each_log,
    is_fresh,
    opened,
    write_beside,
)
from anchorflow_training.driving.vocabulary import clustered
from anchorflow_training.settings import ConfigError

Floats = NDArray[np.float32]

HEADING_M = 5.0
"""m that a radian counts for when futures are clustered."""


def examples_of(logs: Sequence[Path]) -> Floats:
    """What there is to imitate in the windows of logs: poses [M, T, 3], m and rad."""
    shown = (example(window) for log in logs for window in Scenes(read_log(log)))
    return np.array([poses for poses in shown if poses is not None], np.float32)


def trajectory_anchors(futures: NDArray[np.floating], *, count: int, seed: int) -> Floats:
    """K anchors [K, T, 3] of futures [M, T, 3], by k-means over x, y and heading.

    Raises:
        ConfigError: there is none.
    """
    if not len(futures):
        raise ConfigError("anchors: expected examples to cluster, found none in any window")
    units = np.array([1.0, 1.0, HEADING_M])
    points = (futures * units).reshape(len(futures), -1)
    centres = clustered(points, count=count, seed=seed)
    return (centres.reshape(count, -1, 3) / units).astype(np.float32)


def read_anchors(path: Path, *, count: int, steps: int) -> Floats:
    """Anchors [K, T, 3] of a .npy file.

    Raises:
        ConfigError: it cannot be read, or holds anything but K trajectories of finite numbers.
    """
    try:
        anchors = np.load(path, allow_pickle=False)
    except UNREADABLE as error:
        raise ConfigError(f"anchors: {path}: {error}") from error
    if anchors.shape != (count, steps, 3):
        wanted = [count, steps, 3]
        raise ConfigError(f"anchors: {path}: expected shape {wanted}, got {list(anchors.shape)}")
    if anchors.dtype.kind not in "iuf" or not np.isfinite(anchors).all():
        raise ConfigError(f"anchors: {path}: expected finite numbers, got {anchors.dtype}")
    return anchors.astype(np.float32)


def anchor_scores(
    logs: Sequence[Path], anchors: Floats, *, progress: Progress = lambda *_: None
) -> Floats:
    """PDM sub-scores [W, K, 5] of anchors in all windows of logs, in the order of SUB_SCORES.

    Those of each log are worked out once, on every core, and kept beside it under the anchors'
    digest. Raises `LogError` where a log or what is kept of it cannot be read, or there is no place
    to write beside it.
    """
    missing = [log for log in logs if not is_fresh(_kept(log, anchors), log)]
    each_log(partial(keep_scores, anchors=anchors), missing, of=len(logs), progress=progress)
    return np.concatenate([_read(_kept(log, anchors)) for log in logs])


def keep_scores(log: Path, *, anchors: Floats) -> None:
    """Score the anchors in every window of a log, and keep that beside the log."""
    plans = anchors.astype(np.float64)
    rows = [PdmScorer(window).score(plans).sub_scores for window in Scenes(read_log(log))]
    table = np.array(rows, np.float16).reshape(-1, len(anchors), len(SUB_SCORES))
    write_beside(_kept(log, anchors), scores=table)


def pdms(scores: NDArray[np.floating]) -> NDArray[np.floating]:
    """PDMS [...] of sub-scores [..., 5]."""
    return PdmScores(*np.moveaxis(scores, -1, 0)).pdms


def _read(path: Path) -> Floats:
    with opened(path) as part:
        return part["scores"].astype(np.float32)


def _kept(log: Path, anchors: Floats) -> Path:
    digest = hashlib.sha256(np.ascontiguousarray(anchors).tobytes()).hexdigest()[:DIGITS]
    return log.with_suffix(f".pdm-{digest}")
