"""What is chosen at export changes the bundle, not the network that it is made of."""

from __future__ import annotations

import torch

from anchorflow_export.adapter import ExportChoices
from anchorflow_export.planners.flowmp import flowmp_adapter
from anchorflow_models import L2Config, L2SafetyCFM


def test_wider_noise_is_the_bundles_own() -> None:
    model = L2SafetyCFM(L2Config(map_size=16, feature_channels=4))
    before = model.prior.factor.clone()
    choices = ExportChoices(noise_scale=1.4)
    for _ in range(2):
        adapted = flowmp_adapter(model, choices).model
        assert isinstance(adapted, L2SafetyCFM)
        torch.testing.assert_close(adapted.prior.factor, 1.4 * before)
    torch.testing.assert_close(model.prior.factor, before)
