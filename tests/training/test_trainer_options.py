"""Every option of the trainer does what it says: each test fails where its option is not read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from training_runs import launched

from anchorflow_training.batches import FlowBatchConfig, draw_batch
from anchorflow_training.config import FlowMatchingConfig, TrainerConfig
from anchorflow_training.dataset import SceneDataset, open_dataset
from anchorflow_training.objective import draw_flow_times
from anchorflow_training.settings import ConfigError, build, merged, nested
from anchorflow_training.trainer import CFMTrainer

Make = Callable[..., CFMTrainer]
BASE: dict[str, Any] = {
    "steps": 2,
    "warmup": 0,
    "report_every": 1,
    "checkpoint_every": 100,
    "tensorboard": False,
    "batch": {"scenes": 2, "samples": 4},
    "model": {"map_size": 16, "feature_channels": 4, "layers": 1},
}


def trainer(dataset: SceneDataset, out: Path, options: Mapping[str, Any]) -> CFMTrainer:
    values = BASE
    for path, value in options.items():
        values = merged(values, nested(path, value))
    return CFMTrainer(build(TrainerConfig, values, source="test"), dataset, out)


def dotted(options: Mapping[str, Any]) -> dict[str, Any]:
    return {name.replace("__", "."): value for name, value in options.items()}


def losses(run: CFMTrainer) -> list[float]:
    return [row["loss"] for row in run.curve]


@pytest.fixture
def make(tiny_dataset: SceneDataset, tmp_path: Path) -> Make:
    """Makes a run with some options in a folder of the test's own."""
    return lambda name="run", **options: trainer(tiny_dataset, tmp_path / name, dotted(options))


@pytest.fixture
def fit(make: Make) -> Make:
    """Makes such a run and trains it."""

    def fit(name: str = "run", **options: Any) -> CFMTrainer:
        run = make(name, **options)
        run.fit()
        return run

    return fit


@pytest.fixture(scope="module")
def base(tiny_dataset_path: Path, tmp_path_factory: pytest.TempPathFactory) -> CFMTrainer:
    run = trainer(open_dataset(tiny_dataset_path), tmp_path_factory.mktemp("base"), {})
    run.fit()
    return run


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("learning_rate", 1e-4),
        ("warmup", 5),
        ("gradient_clip", 1e-4),
        ("weight_decay", 50.0),
        ("batch.seed", 1),
        ("flow.optimal_transport", False),
        ("flow.flow_time", "logit_normal"),
        ("flow.weights.lambda_vel", 2.0),
        ("flow.weights.lambda_acc", 2.0),
        ("flow.weights.lambda_jerk", 2.0),
        ("flow.weights.lambda_roughness", 2.0),
        ("flow.weights.lambda_duration", 2.0),
    ],
)
def test_the_option_changes_what_is_learnt(
    path: str, value: Any, base: CFMTrainer, fit: Make
) -> None:
    run = fit(**{path: value})
    pairs = ((run.average[n], w) for n, w in base.average.items())
    assert any(not torch.allclose(ours, theirs, rtol=1e-4, atol=1e-8) for ours, theirs in pairs)


def test_a_report_is_the_mean_of_its_steps(base: CFMTrainer, fit: Make) -> None:
    run = fit(report_every=2)
    np.testing.assert_allclose(losses(run), [np.mean(losses(base))], rtol=1e-5)


def test_ema_decay_zero_is_the_weights_themselves(fit: Make) -> None:
    run = fit(ema_decay=0.0)
    torch.testing.assert_close(run.average, dict(run.model.state_dict()))


def test_accumulated_gradients_are_the_mean_of_the_batches(
    tiny_dataset: SceneDataset, make: Make, fit: Make
) -> None:
    single = make("a")
    batches = [draw_batch(tiny_dataset, single.config.batch, index) for index in range(2)]
    parts = [single._loss(batch, index)[0] for index, batch in enumerate(batches)]
    mean = sum(parts[1:], parts[0]) / 2
    gradients = torch.autograd.grad(mean, list(single.model.parameters()), allow_unused=True)
    norm = torch.cat([g.flatten() for g in gradients if g is not None]).norm()

    run = fit("b", steps=1, accumulate=2)
    np.testing.assert_allclose(losses(run), [mean.item()], rtol=1e-5)
    np.testing.assert_allclose(run.curve[0]["gradient_norm"], norm.item(), rtol=1e-4)


def test_two_processes_see_what_two_accumulated_batches_see(
    tiny_dataset: SceneDataset, tmp_path: Path, make: Make, fit: Make
) -> None:
    alone = fit("alone", accumulate=2)
    words = ["--devices=2", "--accelerator=cpu", "--threads=1", "--steps=2", "--warmup=0"]
    words += ["--report-every=1", "--scenes=2", "--samples=4", "--no-tensorboard"]
    words += ["--model.map-size=16", "--model.feature-channels=4", "--model.layers=1"]
    told = launched(tmp_path, "train", tiny_dataset.path, "--out", tmp_path / "both", *words)
    both = make("both", accumulate=2)
    assert both.step == 2
    np.testing.assert_allclose(losses(both), losses(alone), rtol=1e-4)
    assert told.count("step 2 loss") == 1


def test_bfloat16_rounds_and_float32_does_not(base: CFMTrainer, fit: Make) -> None:
    half = fit("half", precision="bfloat16")
    full = fit("full", precision="float32", accelerator="cpu")
    assert losses(half) != losses(full)
    np.testing.assert_allclose(losses(half), losses(full), rtol=2e-2)
    if not torch.cuda.is_available():
        assert losses(base) == losses(full)


@pytest.mark.skipif(torch.cuda.is_available(), reason="needs a machine without a GPU")
@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"accelerator": "cuda"}, "accelerator: expected a CUDA GPU"),
        ({"precision": "float16"}, "precision: float16 needs a GPU"),
    ],
)
def test_what_the_machine_lacks_is_named(option: dict[str, str], message: str, make: Make) -> None:
    with pytest.raises(ConfigError, match=message):
        make(**option)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("precision", ["auto", "float16", "bfloat16"])
def test_a_gpu_trains_as_a_cpu_does(precision: str, fit: Make) -> None:
    on_cpu = fit("cpu", accelerator="cpu")
    on_gpu = fit("gpu", accelerator="cuda", precision=precision)
    np.testing.assert_allclose(losses(on_gpu), losses(on_cpu), rtol=3e-2)


# torch's own compiler still uses what torch has deprecated.
@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
def test_compile_compiles_the_networks_in_place(base: CFMTrainer, fit: Make) -> None:
    def compiled(run: CFMTrainer) -> bool:
        return run.model.cost_map_encoder._compiled_call_impl is not None

    with torch.compiler.set_stance("force_eager"):
        run = fit(compile=True)
    assert compiled(run)
    assert not compiled(base)
    assert run.average.keys() == base.average.keys()


@pytest.fixture
def thread_count() -> Iterator[int]:
    before = torch.get_num_threads()
    yield before
    torch.set_num_threads(before)


def test_threads(thread_count: int, make: Make) -> None:
    make("a", threads=thread_count + 1)
    assert torch.get_num_threads() == thread_count + 1
    make("b")
    assert torch.get_num_threads() == thread_count + 1


def test_a_batch_larger_than_the_dataset_is_refused(make: Make) -> None:
    with pytest.raises(ConfigError, match=r"batch\.scenes: expected at most 6.*got 7"):
        make(batch__scenes=7)


def test_mirror_off_keeps_every_scene_as_it_is(
    base: CFMTrainer, tiny_dataset: SceneDataset, make: Make
) -> None:
    starts = {float(x) for x in tiny_dataset.arrays["x_curr"][:, 1]}
    drawn = {True: set(), False: set()}
    for mirror, seen in drawn.items():
        config = FlowBatchConfig(scenes=2, samples=1, mirror=mirror)
        for index in range(12):
            seen |= {float(x) for x in draw_batch(tiny_dataset, config, index)["x_curr"][:, 1]}
    assert drawn[False] == starts
    assert drawn[True] > starts
    # The prior too leans where the data lean.
    run = make(batch__mirror=False)
    assert not torch.allclose(run.model.prior.factor, base.model.prior.factor)


@pytest.mark.parametrize(
    ("config", "quantile"),
    [
        (FlowMatchingConfig(), lambda u: u),
        (FlowMatchingConfig(flow_time="late", late_power=3.0), lambda u: u ** (1 / 3)),
        (
            FlowMatchingConfig(flow_time="logit_normal", logit_mean=0.5, logit_std=1.5),
            lambda u: torch.sigmoid(0.5 + 1.5 * torch.special.ndtri(u)),
        ),
    ],
    ids=["uniform", "late", "logit_normal"],
)
def test_flow_times_follow_their_distribution(config: FlowMatchingConfig, quantile: Any) -> None:
    t = draw_flow_times(config, (100, 200), torch.Generator().manual_seed(0))
    shares = torch.tensor([0.1, 0.25, 0.5, 0.75, 0.9])
    assert t.shape == (100, 200)
    torch.testing.assert_close(t.flatten().quantile(shares), quantile(shares), atol=0.015, rtol=0)
