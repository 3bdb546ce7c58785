"""A model back from a checkpoint."""

from __future__ import annotations

from anchorflow_models import L2Config, L2SafetyCFM, create_l2_safety_cfm

from anchorflow_training.checkpoint import Checkpoint


def restore_model(checkpoint: Checkpoint) -> L2SafetyCFM:
    """The trained model with its averaged weights, ready to use."""
    model = create_l2_safety_cfm(L2Config(**checkpoint.config["model"]))
    model.load_state_dict(checkpoint.average)
    return model.eval()
