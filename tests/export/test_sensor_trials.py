"""What the proof of planners that see is fed with: nothing that they are told is nought."""

from __future__ import annotations

import torch

from anchorflow_export.planners.sensors import random_sensors
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle


def test_every_number_of_the_ego_status_varies() -> None:
    bundle = load_bundle(DEFAULT_BUNDLE.parent / "wote")
    status = random_sensors(bundle, 64, torch.Generator().manual_seed(0))["ego_status"]
    assert (status[:, :4].sum(1) == 1).all()
    assert (status.std(0) > 0.3).all()
    assert (status[:, 4] >= 0).all()
