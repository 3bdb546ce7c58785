"""Map a function over tasks in processes of their own, or in this one."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any


@contextmanager
def mapper(workers: int) -> Iterator[Callable[..., Any]]:
    """Yield `map` over that many processes, in the order of the tasks; of one, `map` itself."""
    if workers == 1:
        yield map
        return
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield partial(pool.imap, chunksize=8)
