"""Files of arrays that a benchmark reads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_driving.errors import UNREADABLE


def read_arrays(path: Path, keys: Sequence[str], *, what: str) -> dict[str, NDArray[Any]]:
    """The arrays of a .npz file that holds `what`.

    Raises:
        BenchmarkError: the file cannot be read or lacks one of the keys.
    """
    try:
        with np.load(path) as file:
            for key in keys:
                if key not in file.files:
                    raise ValueError(f"expected the key {key!r}, found {', '.join(file.files)}")
            return {key: file[key] for key in keys}
    # A .npy file opens as an array, which no `with` takes.
    except (*UNREADABLE, TypeError, AttributeError) as error:
        raise BenchmarkError(f"{path}: not a file of {what} ({error})") from error
