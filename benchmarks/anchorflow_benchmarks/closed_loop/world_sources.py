"""Where worlds come from: files of worlds or of scenes, corridors and forests that are drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from anchorflow_benchmarks.closed_loop.forests import LIMITS, draw_forests, world_of_scene
from anchorflow_benchmarks.closed_loop.world import (
    DRAWN,
    LEAST_GAP,
    World,
    draw_world,
    read_worlds,
)
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.scene_files import count_and_seed, read_scenes, spread_evenly
from anchorflow_driving.errors import UNREADABLE

FORESTS = "forests"
MOST_GAP = 0.25  # m, that drawing finds in a reasonable time


def load_worlds(source: str, *, limit: int | None = None) -> list[World]:
    """Worlds of a .npz file, `drawn:COUNT:SEED` or `forests:COUNT:SEED`.

    `:GAP` after the seed is the least gap in m, in place of LEAST_GAP: `drawn:20:0:0.12`. A file
    holds worlds, or scenes as `scene_files` reads them. At most `limit` of them are taken,
    evenly spread.

    Raises:
        BenchmarkError: the file holds neither, or a scene that the robot cannot cross; or the text
            is not of these forms.
    """
    kind, _, rest = source.partition(":")
    if kind == DRAWN:
        count, seed, gap = _drawing(kind, rest)
        worlds = [draw_world(1000 * seed + index, least_gap=gap) for index in range(count)]
    elif kind == FORESTS:
        count, seed, gap = _drawing(kind, rest)
        worlds = draw_forests(count, seed, least_gap=gap)
    elif _holds_scenes(path := Path(source)):
        scenes = enumerate(read_scenes(path, limits=LIMITS))
        worlds = [world_of_scene(scene, f"{scene.family} {index}") for index, scene in scenes]
    else:
        worlds = read_worlds(path)
    return spread_evenly(worlds, limit)


def _drawing(kind: str, text: str) -> tuple[int, int, float]:
    """Count, seed and least gap in m of `COUNT:SEED` or `COUNT:SEED:GAP`."""
    drawn, _, gap = text.rpartition(":") if text.count(":") == 2 else (text, "", LEAST_GAP)
    count, seed = count_and_seed(drawn, kind)
    try:
        least = float(gap)
    except ValueError:
        least = np.nan
    if not 0.0 <= least <= MOST_GAP:
        raise BenchmarkError(f"expected a GAP from 0 to {MOST_GAP} m, got {kind}:{text}")
    return count, seed, least


def _holds_scenes(path: Path) -> bool:
    """Whether it is a .npz file with the maps of scenes; what is none is `read_worlds`' to tell."""
    try:
        with np.load(path) as file:
            return "occupancy" in file.files
    except (*UNREADABLE, TypeError, AttributeError):
        return False
