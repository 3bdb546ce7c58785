"""Checks of what a caller gives: a ValueError names the field, what was expected and what came."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from torch import Tensor


def check(name: str, holds: object, expected: str, got: object) -> None:
    """Raise ValueError unless it holds."""
    if not holds:
        raise ValueError(f"{name}: expected {expected}, got {got}")


def numbers(name: str, value: ArrayLike | Tensor) -> NDArray[np.float32]:
    """The value as float32, finite; a tensor may be on any device."""
    array = value.detach().cpu().numpy() if isinstance(value, Tensor) else np.asarray(value)
    array = array.astype(np.float32)
    check(name, np.isfinite(array).all(), "finite numbers", "NaN or infinity")
    return array


def batched(
    name: str, value: ArrayLike | Tensor, shape: str, sizes: tuple[int | None, ...]
) -> NDArray[np.float32]:
    """One scene's array or several scenes' as [B, ...].

    shape: as the message says it; sizes: of the axes after B, None where any will do
    """
    given = numbers(name, value)
    array = given[None] if given.ndim == len(sizes) else given
    fits = array.ndim == len(sizes) + 1 and all(
        size in (None, got) for size, got in zip(sizes, array.shape[1:], strict=True)
    )
    check(name, fits, f"{shape} or [B, {shape[1:]}", list(given.shape))
    return array
