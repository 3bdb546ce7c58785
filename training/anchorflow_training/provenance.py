"""Where a model's weights come from, for the bundle's manifest."""

from __future__ import annotations

from typing import Any

from anchorflow_training.checkpoint import Checkpoint

CURVE_POINTS = 40


def provenance(checkpoint: Checkpoint) -> dict[str, Any]:
    """Steps, configuration, data and a thinned loss curve; of a student its teacher too, and of a
    mean what it is the mean of.
    """
    stride = max(1, len(checkpoint.curve) // CURVE_POINTS)
    more = {"teacher": checkpoint.teacher, "mean_of": checkpoint.mean_of}
    return {
        "steps": checkpoint.step,
        "config": checkpoint.config,
        "data": checkpoint.data,
        "loss": [[row["step"], round(row["loss"], 4)] for row in checkpoint.curve[::stride]],
        **{name: value for name, value in more.items() if value},
    }
