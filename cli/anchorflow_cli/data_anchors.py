"""`anchorflow data anchors` and `sensors`: what planners that see learn from, of driving logs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.progress import Progress

from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import file_option
from anchorflow_training.driving.anchors import anchor_scores, examples_of, trajectory_anchors
from anchorflow_training.driving.driving_run import SensorRunConfig
from anchorflow_training.driving.log_cache import open_logs
from anchorflow_training.driving.sensor_windows import SensorSizes, open_sensor_windows
from anchorflow_training.planners import training_of
from anchorflow_training.settings import ConfigError, layers

LogsArgument = Annotated[Path, typer.Argument(metavar="LOGS", help="Folder of driving logs.")]


def anchors(
    logs: LogsArgument,
    *,
    out: Annotated[Path, file_option("File to write (.npy), [K, 8, 3].")],
    count: Annotated[int, typer.Option(min=1, help="K.")] = 256,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same bytes.")] = 0,
) -> None:
    """Cluster examples into anchors, and score each in every window.

    The PDM sub-scores are kept beside the logs; you can stop and restart it.
    """
    paths = open_logs(logs)
    futures = examples_of(paths)
    centres = trajectory_anchors(futures, count=count, seed=seed)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with out.open("wb") as file:
            np.save(file, centres)
    except OSError as error:
        raise ConfigError(f"{out}: expected a place to write ({error})") from error
    table = with_bar("logs scored", lambda tell: anchor_scores(paths, centres, progress=tell))
    apart = np.linalg.norm(futures[:, None, :, :2] - centres[None, ..., :2], axis=-1).mean(-1)
    typer.echo(
        f"{out}: {count} anchors of {len(table)} windows, the nearest {apart.min(1).mean():.2f} m "
        "from its example"
    )


def sensors(
    logs: LogsArgument,
    *,
    config: Annotated[Path, typer.Option(help="Of the run that is to learn from them (YAML).")],
) -> None:
    """Draw the simulated camera and LiDAR of every window, and keep them beside the logs.

    You can stop and restart it; `anchorflow train` draws what is missing.
    """
    kind = training_of(None, config).config
    if not issubclass(kind, SensorRunConfig):
        raise ConfigError(
            f"{config}: planner: expected one that sees by camera and LiDAR, got {kind.planner!r}"
        )
    run: Any = layers(kind, {}, config)
    sizes = SensorSizes.of(run.model.backbone)
    with needs_extra("driving", who="anchorflow data sensors"):
        import moderngl  # noqa: F401 - so that its absence is one line
    windows = with_bar(
        "logs drawn", lambda tell: open_sensor_windows(open_logs(logs), sizes, progress=tell)
    )
    size = sum(map(len, windows.streams)) / 1e6
    typer.echo(f"{logs}: simulated sensors of {len(windows)} windows, {size:.1f} MB")


def with_bar(what: str, work: Callable[[Callable[[int, int], None]], Any]) -> Any:
    """Do some work with a progress bar."""
    with Progress() as bar:
        task = bar.add_task(what)
        return work(lambda done, of: bar.update(task, completed=done, total=of))
