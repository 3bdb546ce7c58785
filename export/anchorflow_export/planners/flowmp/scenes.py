"""Random scenes for the proof: inputs as the service makes them, of any size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from anchorflow_client.contract import AnchorRequest, ModelCard, resolve_for_card
from anchorflow_service.bundle import Bundle
from anchorflow_service.engine.conditioning.cost_map import CostMapConditioning, MapScene
from anchorflow_trajectory.scene import ROUTE_STATES

CELLS_A_BLOB = 40  # one square obstacle for so many cells of the map


def random_scenes(
    bundle: Bundle, count: int, shape: tuple[int, int], *, seed: int
) -> list[MapScene]:
    """Cluttered maps of `shape` (H, W), as a request of `count` scenes brings them."""
    generator, card = np.random.default_rng(seed), bundle.card
    request = resolve_for_card(_random_request(card, count, shape, generator), card)
    return CostMapConditioning(bundle.manifest).scenes(request)


def stacked_inputs(bundle: Bundle, scenes: Sequence[MapScene]) -> dict[str, Tensor]:
    """The encode inputs of scenes, by name and on a B axis."""
    names = bundle.manifest.graphs["encode"].input_names
    inputs = [scene.inputs(names) for scene in scenes]
    return {name: torch.from_numpy(np.concatenate([one[name] for one in inputs])) for name in names}


def dealt_means(scenes: Sequence[MapScene], count: int) -> Tensor:
    """Prior means [B,N,T,S]: the routes of each scene, dealt out in turn to N = `count` anchors."""
    components = [scene.inputs((ROUTE_STATES,))[ROUTE_STATES][0] for scene in scenes]
    dealt = [each[np.arange(count) % len(each)] for each in components]
    return torch.from_numpy(np.stack(dealt))


def _random_request(
    card: ModelCard, scenes: int, shape: tuple[int, int], generator: np.random.Generator
) -> AnchorRequest:
    resolution = 10.0 / max(shape)  # m/cell: maps of 10 m, whatever their cells
    extent = resolution * np.array(shape[::-1])
    origin = generator.uniform(-20.0, 20.0, 2)
    maps = generator.random((scenes, card.cost_map.channels, *shape), dtype=np.float32)
    maps[:, 0] = [_clutter(shape, generator) for _ in range(scenes)]
    ends = origin + generator.uniform(0.1, 0.9, (scenes, 2, 2)) * extent
    motion = generator.uniform(-1.0, 1.0, (scenes, 3 * card.D))
    headings = generator.uniform(-np.pi, np.pi, (scenes, 2, card.D - 2))
    columns, rows = np.moveaxis(((ends - origin) / resolution).astype(int), -1, 0)
    maps[np.arange(scenes)[:, None], 0, rows, columns] = 0.0
    start, goal = np.concatenate([ends, headings], axis=-1).swapaxes(0, 1)
    at_start, at_goal = np.split(motion, [2 * card.D], axis=1)
    return AnchorRequest.build(
        cost_map={"data": maps, "resolution": resolution, "origin": origin},
        x_curr=np.concatenate([start, at_start], axis=1),
        x_goal=np.concatenate([goal, at_goal], axis=1),
        w_style=generator.dirichlet(np.ones(3), scenes),
        **_some_limits(card, generator),
    )


def _some_limits(card: ModelCard, generator: np.random.Generator) -> dict[str, float]:
    """About half of the limits that a request may set, each anywhere in its range."""
    return {
        name: float(generator.uniform(*between))
        for name, between in card.cost_map.ranges.items()
        if generator.random() < 0.5
    }


def _clutter(shape: tuple[int, int], generator: np.random.Generator) -> np.ndarray:
    """Occupancy [H,W] with square obstacles of two to five cells."""
    occupancy = np.zeros(shape, np.float32)
    for _ in range(shape[0] * shape[1] // CELLS_A_BLOB):
        row, column = generator.integers(0, shape)
        size = generator.integers(2, 6)
        occupancy[row : row + size, column : column + size] = generator.uniform(0.5, 1.0)
    return occupancy
