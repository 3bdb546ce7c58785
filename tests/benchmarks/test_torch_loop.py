"""The torch loop samples what the model does when its scene is encoded once."""

from __future__ import annotations

from dataclasses import asdict
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.torch_loop import TorchLoop
from anchorflow_client.contract import OdeSpec
from anchorflow_models import L2Config, L2SafetyCFM, create_l2_safety_cfm
from anchorflow_service.engine.samplers.ode import Beginning
from anchorflow_training.checkpoint import Checkpoint, save_checkpoint

EULER = OdeSpec("euler", (0.0, 0.5, 1.0))


@pytest.fixture(scope="module")
def model() -> L2SafetyCFM:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = create_l2_safety_cfm(L2Config())
        for parameter in model.parameters():  # the last layers begin at zero
            parameter.data += 0.02 * torch.randn_like(parameter)
        return model.eval()


@pytest.fixture
def checkpoint(model: L2SafetyCFM, tmp_path: Path) -> Path:
    config, weights = {"model": asdict(model.config)}, model.state_dict()
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, Checkpoint(1, config, {}, weights, weights, {}, []))
    return path


def scene(channels: int) -> dict[str, np.ndarray]:
    """The inputs of encode for a scene of 6.4 m with a block in its middle."""
    rng = np.random.default_rng(0)
    cost_map = np.zeros((1, channels, 32, 32), np.float32)
    cost_map[0, 0, 14:18, 14:18] = 1.0
    return {
        "cost_map": cost_map,
        "map_geometry": np.array([[-3.2, -3.2, 0.2]], np.float32),
        "clearance_field": rng.uniform(0, 1, (1, 32, 32)).astype(np.float32),
        "x_curr": np.array([[-2, 0, 0.5, 0, 0, 0]], np.float32),
        "x_goal": np.array([[2, 1, 0, 0]], np.float32),
        "w_style": np.array([[0.4, 0.3, 0.3]], np.float32),
        "limits": np.array([[2.0, 3.0, 0.25, 0.0]], np.float32),
    }


def routes() -> torch.Tensor:
    """[1,2,T,S]: two ways from (-2, 0) to (2, 1) in 3 s, one on each side of the block."""
    share = np.linspace(0.0, 1.0, 64)
    states = np.zeros((1, 2, 64, 7), np.float32)
    states[..., 0], states[..., 2] = 4.0 * share - 2.0, 4.0
    for side, route in zip((-1.5, 1.5), states[0], strict=True):
        route[:, 1] = share + side * np.sin(np.pi * share)
        route[:, 3] = 1.0 + side * np.pi * np.cos(np.pi * share)
        route[:, 5] = -side * np.pi**2 * np.sin(np.pi * share)
    states[..., 6] = np.log(3.0)
    return torch.from_numpy(states)


def test_repeating_the_condition_changes_nothing(model: L2SafetyCFM, checkpoint: Path) -> None:
    inputs = scene(model.config.map_channels)
    mean = routes()[:, [0, 1, 0]]
    with torch.inference_mode():
        context = model.encode(**{name: torch.from_numpy(a) for name, a in inputs.items()})
        x = model.draw(torch.randn(1, 3, model.prior.rank), mean, context)
        start = x[0].numpy()
        for t, end in pairwise(EULER.schedule):
            modulation = model.modulate(torch.tensor([t]), context)[:, 0]
            x = x + (end - t) * model.field(x, mean, modulation, context)

    begun = Beginning(start, np.array([0, 1, 0]), mean[0].numpy())
    got = TorchLoop(checkpoint, threads=torch.get_num_threads()).sample(inputs, begun, EULER)

    assert np.abs(got - start).max() > 1e-2
    np.testing.assert_allclose(got, x[0].numpy(), atol=1e-4)


def test_a_file_that_is_no_checkpoint_is_named(tmp_path: Path) -> None:
    (tmp_path / "text.pt").write_text("no weights")
    with pytest.raises(BenchmarkError, match=r"text\.pt: not a checkpoint"):
        TorchLoop(tmp_path / "text.pt", threads=1)
