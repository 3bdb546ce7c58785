"""WoTE of the published size, its weights random: every shape, and ONNX equal to torch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import onnxruntime as ort
import pytest
import torch
from tiny_wote import sensors
from torch import nn

from anchorflow_client.contract import TensorSpec
from anchorflow_export.adapter import TracedGraph
from anchorflow_export.parity import TOLERANCE
from anchorflow_export.planners.sensors import sensor_inputs
from anchorflow_export.planners.wote.adapter import SCORED, TOLD, Score
from anchorflow_export.tracing import Role, trace
from anchorflow_models.wote import WoTE, WoteConfig, create_wote

CONFIG = WoteConfig()
SHAPES = {
    "camera": ("B", 3, 256, 1024),
    "lidar": ("B", 1, 256, 256),
    "ego_status": ("B", 8),
    "bev_tokens": ("B", 64, 256),
    "ego": ("B", 256),
    "agents": ("B", 30, 5),
    "agent_scores": ("B", 30),
    "bev_semantics": ("B", 8, 128, 256),
    "trajectories": ("B", 256, 8, 3),
    "scores": ("B", 256),
    "offsets": ("B", 256, 8, 3),
    "im_rewards": ("B", 256),
    "sim_rewards": ("B", 256, 5),
}
INNER = {
    "bev_tokens": (64, 256),
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


def test_every_tensor_has_the_published_shape_and_onnx_gives_torchs_numbers(model: WoTE) -> None:
    given = sensors(CONFIG, 1)
    with torch.no_grad():
        encoded = model.encode(**given)
        scored = model.score(encoded["bev_tokens"], encoded["ego"])
    inputs, told = sensor_inputs(CONFIG.backbone), (*model.context_for_score, *TOLD)

    encode = traced(Role(model, "encode", [spec.name for spec in inputs], told), inputs, told)
    assert_equal(encode, given, encoded)
    context = encode.outputs[:2]
    score = traced(Score(model), context, SCORED)
    assert_equal(score, {spec.name: encoded[spec.name] for spec in context}, scored)


@torch.inference_mode()
def test_what_lies_inside_has_the_published_shape(model: WoTE) -> None:
    seen: dict[str, tuple[int, ...]] = {}

    def shape_of(name: str) -> object:
        def note(_module: nn.Module, inputs: tuple[torch.Tensor, ...], _output: object) -> None:
            seen[name] = (*inputs[0].shape,)

        return note

    model.world_model.layers.register_forward_hook(shape_of("tokens of the world model"))  # type: ignore[arg-type]
    given = sensors(CONFIG, 1)
    features = model.backbone(given["camera"], given["lidar"])
    look = model.look(**given)
    moved = model.move(look.bev, look.ego)
    few = moved.taken(torch.arange(256).flip(0)[None])
    judged = model.judge(look.bev, few, fine=look.fine)
    seen |= {
        "bev_tokens": (*look.bev.shape[1:],),
        "encoded_anchors": (*model.encoded_anchors().shape,),
        "ego of each anchor": (*moved.ego.shape[1:],),
        "future BEV": (*judged.future.shape[1:],),
        "BEV features": (*features.features.shape[1:],),
        "upscaled BEV": (*features.upscaled.shape[1:],),
        "future semantics": (*model.future_semantic_logits(judged.future[:, 0]).shape[1:],),
    }
    assert seen == INNER


def traced(module: nn.Module, inputs: Sequence[TensorSpec], outputs: Sequence[str]) -> TracedGraph:
    graph = trace(module, inputs=inputs, outputs=outputs)
    for spec in (*graph.inputs, *graph.outputs):
        assert spec.shape == SHAPES[spec.name], spec.name
    return graph


def assert_equal(
    graph: TracedGraph, inputs: dict[str, torch.Tensor], expected: dict[str, torch.Tensor]
) -> None:
    session = ort.InferenceSession(graph.model.SerializeToString())
    names = [spec.name for spec in graph.outputs]
    arrays = {name: tensor.numpy() for name, tensor in inputs.items()}
    for name, got in zip(names, session.run(names, arrays), strict=True):
        wanted = expected[name].numpy()
        scale = max(1.0, float(np.abs(wanted).max()))
        np.testing.assert_allclose(
            np.asarray(got), wanted, atol=TOLERANCE * scale, rtol=0, err_msg=name
        )
