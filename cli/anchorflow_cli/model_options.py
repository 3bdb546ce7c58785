"""`anchorflow serve`: the options of its models, and of how many requests it plans at a time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from anchorflow_service.bundle import DEFAULT_BUNDLE
from anchorflow_service.planning import PlanningEngine
from anchorflow_service.repository import BundleFolders

BundlesOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--bundle",
        help="Folder of a bundle; repeatable, the first is the default model.",
        show_default="the one that ships",
    ),
]
RepositoryOption = Annotated[
    Path | None,
    typer.Option(
        help="Folder of bundles, FOLDER/NAME or FOLDER/NAME/VERSION, to load and unload from.",
        show_default=False,
    ),
]
BatchOption = Annotated[
    int, typer.Option(min=1, help="Requests of a micro-batch; 1: one after the other.")
]
BatchWaitOption = Annotated[
    float,
    typer.Option(min=0, help="How long [ms] a micro-batch waits for others to join it."),
]
WaitingOption = Annotated[
    int, typer.Option(min=0, help="Requests that may wait; more are refused.")
]
ThreadsOption = Annotated[
    int | None,
    typer.Option(min=1, help="Threads that requests share.", show_default="the cores"),
]


def folders_of(bundles: list[Path] | None, repository: Path | None) -> BundleFolders:
    """Return the folders of the models, by default the bundle that ships."""
    named = bundles or ([] if repository else [DEFAULT_BUNDLE])
    return BundleFolders(named, repository=repository)


def described(engines: Mapping[str, PlanningEngine]) -> str:
    """The models' names and versions, the default first."""
    return ", ".join(f"{each.card.name} {each.card.version}" for each in engines.values())
