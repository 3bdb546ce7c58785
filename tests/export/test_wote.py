"""WoTE at the published size, its final score in onnxruntime, and what proves its parity."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from tiny_wote import sensors
from torch import Tensor, nn

from anchorflow_client.contract import TensorSpec
from anchorflow_export.planners.random_requests import sensor_request
from anchorflow_export.tracing import trace
from anchorflow_models.wote import RewardWeights, WoTE, WoteConfig, create_wote, final_scores
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle

CONFIG = WoteConfig()
# Without the axis of scenes; inside the world model each anchor is one.
SHAPES = {
    "camera": (3, 256, 1024),
    "lidar": (1, 256, 256),
    "ego_status": (8,),
    "bev_tokens": (64, 256),
    "ego": (256,),
    "agents": (30, 5),
    "agent_scores": (30,),
    "bev_semantics": (8, 128, 256),
    "trajectories": (256, 8, 3),
    "scores": (256,),
    "offsets": (256, 8, 3),
    "im_rewards": (256,),
    "sim_rewards": (256, 5),
    "encoded_anchors": (256, 256),
    "ego of each anchor": (256, 256),
    "tokens of the world model": (256, 1 + 64, 256),
    "future BEV": (256, 64, 256),
    "BEV features": (512, 8, 8),
    "upscaled BEV": (64, 64, 64),
    "future semantics": (8, 128, 256),
}


@pytest.fixture(scope="module")
def model() -> WoTE:
    torch.manual_seed(0)
    return create_wote(CONFIG).eval()


@torch.inference_mode()
def test_every_tensor_has_the_published_shape(model: WoTE) -> None:
    """ONNX equals torch in `test_parity.py`, for a smaller network."""
    seen: dict[str, tuple[int, ...]] = {}
    model.world_model.layers.register_forward_hook(
        lambda _module, inputs, _output: seen.update({"tokens of the world model": inputs[0].shape})
    )
    given = sensors(CONFIG, 1)
    encoded = model.encode(**given)
    scored = model.score(encoded["bev_tokens"], encoded["ego"])
    features = model.backbone(given["camera"], given["lidar"])
    look = model.look(**given)
    moved = model.move(look.bev, look.ego)
    few = moved.taken(torch.arange(256).flip(0)[None])
    judged = model.judge(look.bev, few, fine=look.fine)
    inner = {
        "encoded_anchors": model.encoded_anchors()[None],
        "ego of each anchor": moved.ego,
        "future BEV": judged.future,
        "BEV features": features.features,
        "upscaled BEV": features.upscaled,
        "future semantics": model.future_semantic_logits(judged.future[:, 0]),
    }
    shapes = {name: each.shape[1:] for name, each in (given | encoded | scored | inner).items()}
    assert SHAPES.items() <= {**shapes, **seen}.items()


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


def test_every_number_of_the_ego_status_varies() -> None:
    card = load_bundle(DEFAULT_BUNDLE.parent / "wote").card
    status: Any = sensor_request(card, {"B": 64}, 0).inputs["ego_status"]
    assert (status[:, :4].sum(1) == 1).all()
    assert (status.std(0) > 0.3).all()
    assert (status[:, 4] >= 0).all()
