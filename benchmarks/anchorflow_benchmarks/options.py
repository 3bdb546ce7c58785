"""Options that several `anchorflow bench` commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from anchorflow_benchmarks import BenchmarkError
from anchorflow_cli.options import folder_option
from anchorflow_client.contract import ModelCard
from anchorflow_client.http import AnchorClient
from anchorflow_service.bundle import DEFAULT_BUNDLE

RESULTS = Path("benchmarks/results")
STUDENT = DEFAULT_BUNDLE.parent / "student"
SCENES = "FILE|drawn:N:SEED"

Bundle = Annotated[Path, typer.Option(help="Folder of the bundle.")]
Bundles = Annotated[
    list[Path] | None,
    typer.Option("--bundle", help="Folder of a bundle; repeatable.", show_default="that ships"),
]
DrivingBundles = Annotated[
    list[Path] | None,
    typer.Option("--bundle", help="Folder of a bundle that drives too; repeatable."),
]
Scenes = Annotated[str, typer.Option(metavar=SCENES, help="Scenes: a .npz file, or drawn ones.")]
PublicScenes = Annotated[
    str | None,
    typer.Option(
        metavar=SCENES,
        help="Scenes: a .npz file, or drawn ones.",
        show_default="the public scenes, or drawn:60:0 without them",
    ),
]
Num = Annotated[int, typer.Option(min=1, max=512, help="Anchors a request.")]
Sampler = Annotated[str, typer.Option(help="card, rk4:8step, midpoint:uniform2, …")]
Samplers = Annotated[
    str, typer.Option(metavar="A,B", help="card, rk4:8step, rk4:uniform8, midpoint:uniform2, …")
]
Baselines = Annotated[
    str, typer.Option(metavar="A,B", help="Of expert, lines, routes, rrt; none for none.")
]
Threads = Annotated[
    int | None, typer.Option(min=1, help="Threads of a request.", show_default="the cores")
]
AlongRoute = Annotated[
    bool,
    typer.Option("--along-route", help="Each bundle drives twice: then by its route."),
]
Guarded = Annotated[
    bool,
    typer.Option("--guarded", help="Each bundle drives twice: then with its guard."),
]
RouteDrives = Annotated[
    bool,
    typer.Option(
        "--route-drives", help="Each bundle that has them drives also with drives along its route."
    ),
]
Foreseeing = Annotated[
    bool,
    typer.Option(
        "--foreseeing", help="Each bundle with futures drives twice: then told of the others."
    ),
]
Late = Annotated[
    list[int] | None,
    typer.Option(
        "--late-ms",
        help="Each driver drives again with plans that arrive so late; repeatable.",
        show_default="never",
        min=0,
        max=450,
    ),
]
Record = Annotated[
    bool, typer.Option("--record", help="Put each bundle's figures into its manifest.")
]
Out = Annotated[Path, folder_option("Folder that the results are written to.")]


def first_card(url: str) -> ModelCard:
    """Return the card of a service's default model.

    Raises `TransportError` if the service does not answer; `BenchmarkError` if it serves no model.
    """
    with AnchorClient(url) as client:
        for card in client.models():
            return card
    raise BenchmarkError(f"{url}: expected a service of a model, found none")


def comma_separated(text: str) -> list[str]:
    """Return the names in `A,B`; none of them if the text is `none`."""
    return [] if text == "none" else text.split(",")


def whole_numbers(text: str, option: str) -> list[int]:
    """Return `1,16,64` as numbers; raise `BenchmarkError` unless all are above 0."""
    parts = text.split(",")
    if not all(part.isdecimal() and int(part) > 0 for part in parts):
        raise BenchmarkError(f"{option}: expected whole numbers above 0 such as 1,16, got {text!r}")
    return [int(part) for part in parts]
