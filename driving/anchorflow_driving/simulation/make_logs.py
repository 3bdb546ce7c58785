"""Make a folder of simulated logs; log i depends on the seed and on i alone."""

from __future__ import annotations

import json
import multiprocessing
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from anchorflow_driving.errors import LogError, place_to_write
from anchorflow_driving.log import SIMULATED, write_log
from anchorflow_driving.simulation import LogConfig
from anchorflow_driving.simulation.simulated_log import simulate_log

SUMMARY = "drive.json"


def make_logs(
    folder: Path,
    config: LogConfig,
    *,
    logs: int,
    workers: int,
    progress: Callable[[int], None] = lambda _: None,
) -> dict[str, Any]:
    """Writes logs and `drive.json`, which it returns; `progress` gets 1 a finished log.

    The summary holds the numbers of logs, windows, turning and standing ones among them, and what
    was dropped or redrawn by its reason.

    Raises `SimulationError` if SUMO's programs do not run here; `LogError` if the folder holds
    other logs than these, or a log cannot be written.
    """
    _refuse_others(folder, {f"{SIMULATED}-{config.seed}-{index:05d}.npz" for index in range(logs)})
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SUMMARY).unlink(missing_ok=True)
    counts: Counter[str] = Counter()
    tasks = ((folder, config, index) for index in range(logs))
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        for counted in pool.imap(_made, tasks):
            counts += counted
            progress(1)
    summary = {
        "format": 1,
        "source": "simulated",
        "logs": logs,
        **{name: counts[name] for name in ("windows", "turning", "moving", "standing")},
        "commands": {name: counts[name] for name in ("left", "straight", "right")},
        "dropped": _counted(counts, "dropped: "),
        "redrawn": _counted(counts, "redrawn: "),
        "config": asdict(config),
    }
    with place_to_write(folder / SUMMARY):
        (folder / SUMMARY).write_text(json.dumps(summary, indent=1) + "\n")
    return summary


def _refuse_others(folder: Path, made: set[str]) -> None:
    """Refuse a folder with other logs, since training reads all of them."""
    others = sorted(path.name for path in folder.glob("*.npz") if path.name not in made)
    if others:
        raise LogError(
            folder,
            "folder",
            expected="a new one, or one of the same seed with no more logs",
            found=f"{others[0]} and {len(others) - 1} more" if others[1:] else others[0],
        )


def _made(task: tuple[Path, LogConfig, int]) -> Counter[str]:
    folder, config, index = task
    log, counts = simulate_log(config, index)
    write_log(log, folder / f"{log.name}.npz")
    return counts


def _counted(counts: Counter[str], prefix: str) -> dict[str, int]:
    return {
        name.removeprefix(prefix): count
        for name, count in sorted(counts.items())
        if name.startswith(prefix)
    }
