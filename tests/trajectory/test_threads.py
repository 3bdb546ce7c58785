"""The cores that a container leaves to a process."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from anchorflow_trajectory.threads import usable_cores

V2 = {"proc/self/cgroup": "0::/\n"}
V1 = {"proc/self/cgroup": "5:devices:/docker/ab\n4:cpu,cpuacct:/docker/ab\n"}
BELOW = {"proc/self/cgroup": "0::/pod/app\n"}


@pytest.fixture(autouse=True)
def _eight_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)))


@pytest.mark.parametrize(
    ("files", "cores"),
    [
        (V2 | {"sys/fs/cgroup/cpu.max": "200000 100000\n"}, 2),
        (V2 | {"sys/fs/cgroup/cpu.max": "150000 100000\n"}, 2),
        (V2 | {"sys/fs/cgroup/cpu.max": "50000 100000\n"}, 1),
        (V2 | {"sys/fs/cgroup/cpu.max": "max 100000\n"}, 8),
        (V2 | {"sys/fs/cgroup/cpu.max": "1600000 100000\n"}, 8),
        (V2, 8),
        ({"sys/fs/cgroup/cpu.max": "300000 100000\n"}, 3),
        (BELOW | {"sys/fs/cgroup/pod/app/cpu.max": "400000 100000\n"}, 4),
        (
            BELOW
            | {
                "sys/fs/cgroup/pod/app/cpu.max": "max 100000\n",
                "sys/fs/cgroup/pod/cpu.max": "300000 100000\n",
            },
            3,
        ),
        *(
            (
                V1
                | {
                    f"sys/fs/cgroup/{folder}/cpu.cfs_quota_us": quota,
                    f"sys/fs/cgroup/{folder}/cpu.cfs_period_us": "100000\n",
                },
                cores,
            )
            for folder, quota, cores in (
                ("cpu,cpuacct", "200000\n", 2),
                ("cpu,cpuacct/docker/ab", "300000\n", 3),
                ("cpu", "120000\n", 2),
                ("cpu,cpuacct", "-1\n", 8),
            )
        ),
        ({}, 8),
    ],
)
def test_cores_are_no_more_than_the_quota(
    tmp_path: Path, files: dict[str, str], cores: int
) -> None:
    """Case V1."""
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content)

    assert usable_cores(tmp_path) == cores
