"""The initial weights of a student, and the settings that it must share."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

from anchorflow_models import L2Config, create_l2_safety_cfm
from anchorflow_training.distillation.objective import NormalisedFlow, start_states
from anchorflow_training.distillation.teacher import Teacher, begin_as, check_student
from anchorflow_training.settings import ConfigError

Inputs = dict[str, torch.Tensor]


def begun(teacher: Teacher, **changed: Any) -> Any:
    model = create_l2_safety_cfm(replace(teacher.model.config, **changed))
    begin_as(model, teacher.model)
    return model.eval()


@torch.no_grad()
def velocity(model: Any, inputs: Inputs, prior_mean: torch.Tensor) -> torch.Tensor:
    z = torch.randn(prior_mean.shape, generator=torch.Generator().manual_seed(2))
    return NormalisedFlow.of(model, inputs, prior_mean).velocity(z, torch.tensor([0.3]))


def test_a_student_of_the_teacher_s_size_begins_as_the_teacher(
    teacher: Teacher, inputs: Inputs, prior_mean: torch.Tensor
) -> None:
    own, taught = (velocity(model, inputs, prior_mean) for model in (begun(teacher), teacher.model))
    torch.testing.assert_close(own, taught, rtol=0, atol=0)


def test_a_shorter_student_is_the_teacher_without_some_blocks(
    teacher: Teacher, inputs: Inputs, prior_mean: torch.Tensor
) -> None:
    """A block whose gates are closed is not there: the teacher without its middle two."""
    short = begun(teacher, layers=2)
    bridged = begun(teacher)
    size = 6 * bridged.config.size.width
    with torch.no_grad():
        for parameter in bridged.vector_field.to_modulation[1].parameters():
            parameter[size : 3 * size] = 0.0
    assert len(short.vector_field.blocks) == 2
    own, expected, taught = (
        velocity(model, inputs, prior_mean) for model in (short, bridged, teacher.model)
    )
    torch.testing.assert_close(own, expected, rtol=1e-4, atol=1e-4)
    assert not torch.allclose(own, taught, atol=1e-2)


@pytest.mark.parametrize(
    "changed", [{"variant": "base"}, {"layers": 6}, {"backbone": "unet"}, {"map_attention": True}]
)
def test_another_network_takes_over_what_fits(changed: dict[str, Any], teacher: Teacher) -> None:
    student = begun(teacher, **changed)
    torch.testing.assert_close(start_states(student), start_states(teacher.model))
    ours, theirs = (
        student.cost_map_encoder.state_dict(),
        teacher.model.cost_map_encoder.state_dict(),
    )
    for name, value in theirs.items():
        torch.testing.assert_close(ours[name], value, rtol=0, atol=0)


@pytest.mark.parametrize(
    "changed", [{"num_steps": 32}, {"degree": 5}, {"num_control_points": 20}, {"dim": 3}]
)
def test_a_student_that_answers_something_else_is_refused(
    changed: dict[str, Any], teacher: Teacher
) -> None:
    (name,) = changed
    other: L2Config = replace(teacher.model.config, **changed)
    with pytest.raises(ConfigError, match=rf"model\.{name}: expected .*, the teacher's, got"):
        check_student(other, teacher.model.config)
