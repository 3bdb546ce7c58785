"""Worlds small enough to reason about, and one thread for torch."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pytest
import torch

from anchorflow_benchmarks.closed_loop.worlds import World


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def world() -> Callable[..., World]:
    """Makes a world of posts [M, 2] of 0.1 m: from (0, 0), facing +x, to (6, 0)."""

    def make(posts: Sequence[tuple[float, float]] | np.ndarray = (), **fields: object) -> World:
        values: dict[str, object] = {
            "name": "test",
            "posts": np.array(posts, dtype=np.float64).reshape(-1, 2),
            "post_radius": 0.1,
            "start": np.zeros(3),
            "goal": np.array([6.0, 0.0]),
            "path_length": 6.0,
        }
        return World(**values | fields)  # type: ignore[arg-type]

    return make
