"""Cooperative recordings of logs: judged as the logs themselves are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anchorflow_driving.cooperative.layout import write_recording
from anchorflow_driving.drivers import collides
from anchorflow_driving.window import Scenes
from anchorflow_training.v2x.dataset import make_pairs
from anchorflow_training.v2x.evaluation import judge
from anchorflow_training.v2x.recording import EGO


def test_a_plan_hits_in_the_recording_whom_it_hits_in_the_log(
    street: Callable, other: type, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A vehicle stands 30 m ahead, and another approaches behind."""
    pytest.importorskip("moderngl", reason="moderngl is not installed")
    from anchorflow_driving.cooperative import from_logs

    blank = np.zeros((3, 8, 8), np.uint8)
    monkeypatch.setattr(from_logs, "_pictures", lambda *_: (blank, blank))
    sizes = np.array([EGO.size, EGO.size, EGO.size], np.float32)
    logs = [
        street(other(30.0, 0.0), other(-30.0, 0.0, 10.0), track_size=sizes, name=name)
        for name in ("a", "b")
    ]
    write_recording(tmp_path / "recording", from_logs.log_drives(logs, None))  # type: ignore[arg-type]
    pairs = make_pairs(tmp_path / "recording", tmp_path / "pairs", image_size=32)
    window = Scenes(logs[0])[0]
    times = 0.1 * np.arange(1, 46)

    # Up to 25.4 m, the contact ahead, and from 19.6 m, the contact behind.
    for way in np.arange(18.05, 28.0, 0.1).tolist():
        plan = np.stack([way * times / 4.5, np.zeros(45)], -1)
        row = judge(pairs, np.array([0]), plan[None])
        assert row["collision_4.5s"] == collides(window, plan), way
        assert collides(window, plan) == (not 19.6 < way < 25.4), way
