"""A loss or gradient that is not finite ends a run before it reaches the weights."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import torch
from lightning_fabric import Fabric
from torch import Tensor

from anchorflow_client.errors import AnchorFlowError


class DivergenceError(AnchorFlowError):
    """A term of the loss is not finite; the message names the step and the term."""


def check_finite(
    terms: Mapping[str, Tensor], *, step: int, fabric: Fabric, checkpoint: Path
) -> None:
    """Raise `DivergenceError` naming every term that is not finite, in all processes alike.

    terms: scalars by name; step: the optimiser step that they would bring about
    checkpoint: what a message may send the reader to
    """
    values = torch.stack([value.detach().float().to(fabric.device) for value in terms.values()])
    # All processes stop, or none: one that is left alone would wait for the others. A sum with a
    # term that is not finite is not finite either.
    shared = torch.as_tensor(fabric.all_reduce(values, reduce_op="sum")).tolist()
    named = zip(terms, shared, strict=True)
    wrong = [f"{name} {value:g}" for name, value in named if not math.isfinite(value)]
    if wrong:
        kept = f"{checkpoint} is as it was" if checkpoint.exists() else "there is no checkpoint yet"
        raise DivergenceError(
            f"step {step}: expected finite loss terms, got {', '.join(wrong)}; the weights are "
            f"untouched and {kept}"
        )
