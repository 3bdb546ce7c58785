"""V2X-VLM's network: what it may and may not depend on, and the parts of its loss."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
import torch
from small_v2x import IMAGE_SIZE, small_sizes, small_v2x
from torch import Tensor

from anchorflow_driving.drivers import waypoint_headings
from anchorflow_models.v2x_vlm import V2XVLM, create_v2x_vlm
from anchorflow_models.v2x_vlm.network import (
    alignment,
    distribution_distillation,
    location,
    next_token,
    poses,
    regression,
    regression_distillation,
)


@pytest.fixture(scope="module")
def model() -> Iterator[V2XVLM]:
    with small_sizes():
        yield small_v2x()


@pytest.fixture
def features(model: V2XVLM) -> Tensor:
    pixels = torch.randint(0, 256, (4, 3, IMAGE_SIZE, IMAGE_SIZE), dtype=torch.uint8)
    return model.look(pixels)


def waypoints(model: V2XVLM, features: Tensor, there: list[bool], tokens: Tensor) -> Tensor:
    vehicle, infrastructure = features.chunk(2)
    return model.drive(model.fuse(vehicle, infrastructure, torch.tensor(there), tokens))


@torch.no_grad()
def test_an_absent_picture_is_not_looked_at(model: V2XVLM, features: Tensor) -> None:
    tokens = torch.randint(4, 200, (2, 9))
    changed = features.clone()
    changed[2:] += 1.0

    without = [waypoints(model, each, [False, False], tokens) for each in (features, changed)]
    with_both = [waypoints(model, each, [True, True], tokens) for each in (features, changed)]

    assert torch.equal(*without)
    assert (with_both[0] - with_both[1]).abs().max() > 1e-4
    assert (with_both[0] - without[0]).abs().max() > 1e-4


@torch.no_grad()
def test_pooled_columns_put_both_pictures_on_the_cells_of_one(features: Tensor) -> None:
    with small_sizes():
        model = small_v2x(pooled_columns=2)
    tokens, there = torch.randint(4, 200, (2, 9)), torch.tensor([True, False])
    vehicle, infrastructure = features.chunk(2)
    fused = model.fuse(vehicle, infrastructure, there, tokens)
    assert fused.hidden.shape[1] == model.config.cells**2 + 1 + 9
    swapped = model.fuse(vehicle.flip(-1), infrastructure, there, tokens).hidden
    torch.testing.assert_close(swapped, fused.hidden, atol=1e-5, rtol=0)
    moved = model.fuse(vehicle.flip(-2), infrastructure, there, tokens).hidden
    assert (moved - fused.hidden).abs().max() > 1e-4


@torch.no_grad()
def test_padding_and_the_other_scene_change_nothing(model: V2XVLM, features: Tensor) -> None:
    tokens = torch.randint(4, 200, (2, 9))
    there = torch.tensor([True, False])
    plain = model.drive(model.fuse(features[:2], features[2:], there, tokens))
    padded = torch.nn.functional.pad(tokens, (0, 5), value=1)
    mask = torch.arange(14).expand(2, -1) < 9

    got = model.drive(model.fuse(features[:2], features[2:], there, padded, mask))
    alone = model.drive(model.fuse(features[:1], features[2:3], there[:1], tokens[:1]))

    torch.testing.assert_close(got, plain, atol=1e-5, rtol=0)
    torch.testing.assert_close(alone, plain[:1], atol=1e-5, rtol=0)
    unmasked = model.drive(model.fuse(features[:2], features[2:], there, padded))
    assert (unmasked - plain).abs().max() > 1e-4


def test_headings_are_the_courses_between_waypoints() -> None:
    rng = np.random.default_rng(0)
    steps = rng.normal(0, 0.1, (6, 45, 2)) * (rng.random((6, 45, 1)) < 0.6)
    steps[0] = 0.0  # who never moves keeps his heading
    path = steps.cumsum(1)

    got = poses(torch.from_numpy(path)).numpy()

    np.testing.assert_allclose(got[..., :2], path)
    for row, wanted in zip(got[..., 2], map(waypoint_headings, path), strict=True):
        np.testing.assert_allclose(row, wanted, atol=1e-12)


@pytest.mark.parametrize("tokenizer", [b'{"version": "1.0"}', b'{"version": "1.0"}\n', b""])
def test_the_tokenizer_travels_with_the_weights(model: V2XVLM, tokenizer: bytes) -> None:
    with small_sizes():
        one, other = (create_v2x_vlm(model.config) for _ in range(2))
    one.tokenizer, other.tokenizer = tokenizer, b"another"
    other.load_state_dict(one.state_dict())
    assert other.tokenizer == tokenizer


def test_alignment_is_infonce_in_both_directions() -> None:
    angle = torch.tensor([0.0, 0.5])
    image = torch.stack([angle.cos(), angle.sin()], -1)
    text = torch.tensor([[1.0, 0.0], [0.0, 1.0]])

    likeness = (image @ text.T / 0.07).tolist()

    def of(own: float, other: float) -> float:
        return -math.log(math.exp(own) / (math.exp(own) + math.exp(other)))

    rows = of(likeness[0][0], likeness[0][1]) + of(likeness[1][1], likeness[1][0])
    columns = of(likeness[0][0], likeness[1][0]) + of(likeness[1][1], likeness[0][1])
    got = alignment(image, text, kappa=0.07).item()
    assert got == pytest.approx((rows + columns) / 4, rel=1e-5)


def test_distillation_as_published_is_blind_to_a_shift() -> None:
    teacher, student = torch.zeros(1, 1, 2), torch.tensor([[[1.0, 0.0]]])
    p = 1 / (1 + math.exp(-0.5))  # of the student's first coordinate at T = 2
    wanted = 4 * (0.5 * math.log(0.5 / p) + 0.5 * math.log(0.5 / (1 - p)))
    got = distribution_distillation(student, teacher, temperature=2.0).item()
    assert got == pytest.approx(wanted, rel=1e-5)

    moved = teacher + 5.0
    assert distribution_distillation(moved, teacher, temperature=2.0).item() == pytest.approx(0)
    assert regression_distillation(moved, teacher).item() == pytest.approx(4.5)


def test_regression_is_smooth_l1_in_metres() -> None:
    driven = torch.zeros(1, 1, 2)
    assert regression(torch.tensor([[[0.5, 3.0]]]), driven).item() == pytest.approx(
        (0.5 * 0.25 + 2.5) / 2
    )


def test_a_place_counts_only_where_somebody_is() -> None:
    nearest = torch.tensor([[1.0, 20.0, -10.0], [0.0, 0.0, 0.0]])
    sure = torch.tensor([30.0, -30.0])
    right = torch.tensor([[2.0, -1.0], [7.0, 7.0]])
    assert location(sure, right, nearest).item() == pytest.approx(0.0, abs=1e-6)
    beside = right + torch.tensor([[1.0, 0.0], [9.0, 9.0]])
    assert location(sure, beside, nearest).item() == pytest.approx(0.25, abs=1e-6)
    assert location(-sure, right, nearest).item() == pytest.approx(30.0, abs=1e-4)


def test_padding_is_no_word() -> None:
    logits, wanted = torch.zeros(1, 2, 4), torch.tensor([[1, 2]])
    logits[0, 1, 3] = 50.0  # as wrong as can be, where nothing stands
    mask = torch.tensor([[True, False]])
    assert next_token(logits, wanted, mask).item() == pytest.approx(math.log(4))
