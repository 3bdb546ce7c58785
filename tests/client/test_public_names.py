"""What the package offers: the clients over zenoh when they are named, and one tree of errors."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
from staged_planner import made_batch

from anchorflow_client import (
    AnchorClient,
    AnchorFlowError,
    AsyncAnchorClient,
    Plan,
    PlannerConfig,
    PlanState,
    RetryingClient,
    resample,
)
from anchorflow_client.errors import UsageError


def run(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program], check=False, capture_output=True, text=True
    )


def test_zenoh_is_loaded_when_its_client_is_named() -> None:
    pytest.importorskip("zenoh")
    program = (
        "import sys, anchorflow_client; assert 'zenoh' not in sys.modules; "
        "from anchorflow_client import AsyncZenohAnchorClient, ZenohAnchorClient; "
        "assert 'zenoh' in sys.modules"
    )
    answer = run(program)
    assert answer.returncode == 0, answer.stderr


def test_without_zenoh_its_client_names_the_extra() -> None:
    program = "import sys; sys.modules['zenoh'] = None; from anchorflow_client import {}"
    answer = run(program.format("ZenohAnchorClient"))
    assert (
        "pip install 'anchorflow[zenoh]', in a checkout pip install -e '.[zenoh]'" in answer.stderr
    )
    assert "cannot import name 'Nonsense'" in run(program.format("Nonsense")).stderr


@pytest.mark.parametrize(
    "misuse",
    [
        lambda: AnchorClient("nonsense"),
        lambda: AsyncAnchorClient("http://127.0.0.1:99999"),
        lambda: AnchorClient("http://127.0.0.1:8000", token="\u2603"),
        lambda: RetryingClient(AnchorClient("http://127.0.0.1:1"), patience_s=-1.0),
        lambda: PlannerConfig(max_age_ms=-1),
        lambda: Plan(PlanState.WAITING).states(),
        lambda: made_batch(np.zeros((2, 3, 4, 2))).best_along([[0, 0], [1, 0]]),
        lambda: resample(np.zeros(3), np.zeros(3), np.zeros(3), dt=0.1, period_s=0.1),
    ],
)
def test_misuse_is_in_the_one_tree(misuse: Callable[[], object]) -> None:
    with pytest.raises(UsageError) as raised:
        misuse()
    assert isinstance(raised.value, AnchorFlowError)
    assert isinstance(raised.value, ValueError)
