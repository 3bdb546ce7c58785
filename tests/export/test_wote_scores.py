"""WoTE's final score in onnxruntime, for rewards that are as good as nothing."""

from __future__ import annotations

import numpy as np
import onnxruntime
import torch
from torch import Tensor, nn

from anchorflow_client.contract import TensorSpec
from anchorflow_export.tracing import trace
from anchorflow_models.wote import RewardWeights, final_scores


class Score(nn.Module):
    def forward(self, imitation: Tensor, simulation: Tensor) -> Tensor:
        return final_scores(imitation, simulation, RewardWeights())


def test_it_is_torchs_where_sigmoids_end() -> None:
    specs = (
        TensorSpec("imitation", "float32", ("B", "K")),
        TensorSpec("simulation", "float32", ("B", "K", 5)),
    )
    graph = trace(Score(), inputs=specs, outputs=["scores"])
    session = onnxruntime.InferenceSession(graph.model.SerializeToString())
    imitation, simulation = torch.randn(1, 6), torch.linspace(-40, 40, 30).view(1, 6, 5)
    fed = {"imitation": imitation.numpy(), "simulation": simulation.numpy()}
    got = np.asarray(session.run(None, fed)[0])
    np.testing.assert_allclose(got, Score()(imitation, simulation).numpy(), rtol=1e-5, atol=1e-5)
