"""Read scenes and their routes from files, or draw scenes with the generator of training."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks import BenchmarkError
from anchorflow_client.contract import DEFAULT_STYLE
from anchorflow_driving.errors import UNREADABLE
from anchorflow_training.scenes import FamilyScene, RobotRanges, SceneError, draw_scene
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.routes.homotopy import Signature

Chosen = TypeVar("Chosen")

DRAWN = "drawn"
WITHOUT_FILE = f"{DRAWN}:60:0"
HELD_OUT = 0x5EED  # separates drawn scenes from those of a dataset with the same seed
STYLE = np.array(DEFAULT_STYLE, np.float32)
ONE_ROBOT = RobotRanges(usual=1.0, fixed=0.0)


def default_source() -> str:
    """Return the path of scenes_public.npz, or drawn scenes if it is missing."""
    path = data_folder() / "scenes_public.npz"
    return str(path) if path.exists() else WITHOUT_FILE


def data_folder() -> Path:
    """Return ANCHORFLOW_SHARED_DATA, or ../shared/data beside the checkout."""
    beside = Path(__file__).resolve().parents[3] / "shared" / "data"
    return Path(os.environ.get("ANCHORFLOW_SHARED_DATA", beside))


def load_scenes(
    source: str, *, limits: MotionLimits, limit: int | None = None
) -> list[FamilyScene]:
    """Load the scenes of a file or of `drawn:COUNT:SEED`; at most `limit`, evenly spread.

    Raises `BenchmarkError` if the file holds no scenes, or the text has another form.
    """
    kind, _, rest = source.partition(":")
    if kind == DRAWN:
        return spread_evenly(draw_scenes(*count_and_seed(rest), limits=limits), limit)
    return spread_evenly(read_scenes(Path(source), limits=limits), limit)


def spread_evenly(rows: list[Chosen], limit: int | None) -> list[Chosen]:
    """Return at most `limit` rows, the first and the last included."""
    if limit is None or limit >= len(rows):
        return rows
    return [rows[i] for i in np.linspace(0, len(rows) - 1, limit).astype(int)]


def read_scenes(path: Path, *, limits: MotionLimits) -> list[FamilyScene]:
    """Read the scenes of a .npz file, each map centred on (0, 0).

    Its keys: occupancy uint8 [S, H, W/8], packed along its last axis, row 0 at the bottom;
    resolution m/cell; x_curr [S, 6]; x_goal [S, 4]; robot_radius m; family [S], of which the
    part before a slash counts.

    Raises `BenchmarkError` if the file cannot be read or lacks a key.
    """
    keys = ("occupancy", "resolution", "x_curr", "x_goal", "robot_radius", "family")
    arrays = read_arrays(path, keys, what="scenes")
    try:
        occupied = np.unpackbits(arrays["occupancy"], axis=-1).astype(bool)
        resolution, radius = float(arrays["resolution"]), float(arrays["robot_radius"])
        rows = zip(arrays["family"], arrays["x_curr"], arrays["x_goal"], occupied, strict=True)
        return [
            _scene(str(family).partition("/")[0], cells, resolution, radius, x_curr, x_goal, limits)
            for family, x_curr, x_goal, cells in rows
        ]
    except (ValueError, TypeError) as error:
        raise BenchmarkError(f"{path}: not a file of scenes ({error})") from error


def read_routes(path: Path) -> list[list[Signature]]:
    """Read the signatures of each scene's routes, shortest first.

    The keys of the .npz file: count [S] routes of each scene; size [R] length of each route's
    signature; signature, all of them concatenated. Obstacles are in the order of `ObstacleRays`.

    Raises `BenchmarkError` if the file cannot be read or lacks a key.
    """
    count, size, flat = read_arrays(path, ("count", "size", "signature"), what="routes").values()
    if count.sum() != len(size) or size.sum() != len(flat):
        raise BenchmarkError(f"{path}: not a file of routes (its counts do not add up)")
    signatures = np.split(flat, np.cumsum(size)[:-1])
    routes = [tuple(signature.tolist()) for signature in signatures]
    ends = np.cumsum(count).tolist()
    return [routes[end - n : end] for end, n in zip(ends, count.tolist(), strict=True)]


def load_routes(path: Path, *, scenes: int, limit: int | None = None) -> list[list[Signature]]:
    """Load the routes of the scenes that `load_scenes` returns for the same limit.

    scenes: how many it returned

    Raises `BenchmarkError` if the file holds no routes, or those of another number of scenes.
    """
    found = spread_evenly(read_routes(path), limit)
    if len(found) != scenes:
        raise BenchmarkError(f"{path}: expected the routes of {scenes} scenes, got {len(found)}")
    return found


def read_arrays(path: Path, keys: Sequence[str], *, what: str) -> dict[str, NDArray[Any]]:
    """Read the arrays of a .npz file that holds `what`.

    Raises `BenchmarkError` if the file cannot be read or lacks one of the keys.
    """
    try:
        with np.load(path) as file:
            for key in keys:
                if key not in file.files:
                    raise ValueError(f"expected the key {key!r}, found {', '.join(file.files)}")
            return {key: file[key] for key in keys}
    # A .npy file opens as an array, which is no context manager.
    except (*UNREADABLE, TypeError, AttributeError) as error:
        raise BenchmarkError(f"{path}: not a file of {what} ({error})") from error


def draw_scenes(
    count: int, seed: int, *, limits: MotionLimits, cells: int = 96
) -> list[FamilyScene]:
    """Draw scenes of all training families that are in no dataset."""
    return list(islice(held_out_scenes(seed, limits=limits, cells=cells), count))


def held_out_scenes(seed: int, *, limits: MotionLimits, cells: int = 96) -> Iterator[FamilyScene]:
    """Draw such scenes without end."""
    for index in itertools.count():
        rng = np.random.default_rng([HELD_OUT, seed, index])
        while True:
            try:
                scene = draw_scene(rng, cells=cells, limits=limits, robots=ONE_ROBOT)
            except SceneError:
                continue
            break
        yield replace(scene, w_style=STYLE)


def count_and_seed(text: str, kind: str = DRAWN) -> tuple[int, int]:
    """Parse `COUNT:SEED`; raise `BenchmarkError` if the text has another form."""
    try:
        count, seed = (int(number) for number in text.split(":"))
    except ValueError:
        raise BenchmarkError(f"expected {kind}:COUNT:SEED, got {kind}:{text}") from None
    if count < 1 or seed < 0:
        raise BenchmarkError(f"expected a COUNT from 1 and a SEED from 0, got {kind}:{text}")
    return count, seed


def in_style(scene: FamilyScene, style: NDArray[np.floating] | None) -> FamilyScene:
    """Return the scene with style weights [3] of any sum; unchanged without weights."""
    if style is None:
        return scene
    return replace(scene, w_style=(style / style.sum()).astype(np.float32))


def _scene(
    family: str,
    occupied: NDArray[np.bool_],
    resolution: float,
    radius: float,
    x_curr: NDArray[np.float32],
    x_goal: NDArray[np.float32],
    limits: MotionLimits,
) -> FamilyScene:
    """Return a scene without soft costs."""
    return FamilyScene(
        family=family,
        cost_map=occupied[None].astype(np.float32),
        resolution=resolution,
        origin=-0.5 * resolution * np.array(occupied.shape[::-1], np.float64),
        robot_radius=radius,
        x_curr=x_curr,
        x_goal=x_goal,
        w_style=STYLE,
        motion=limits,
    )
