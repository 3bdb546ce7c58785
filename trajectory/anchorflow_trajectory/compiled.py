"""Loops compiled to machine code, by numba.

A function marked `@compiled` is compiled for the types of its first call and kept on disk for the
processes that follow. It lets go of the interpreter's lock, so that threads run it side by side;
it is not split among threads and keeps the order of its sums (no `fastmath`), so that it gives the
same bytes alone, in a batch and beside others. Division by zero gives inf or NaN, as in numpy.
"""

from __future__ import annotations

from numba import njit

compiled = njit(cache=True, nogil=True, error_model="numpy")
