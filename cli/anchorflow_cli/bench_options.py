"""Options that several of `anchorflow bench …` have, and what is made of them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.planners import limits_of, request_of
from anchorflow_benchmarks.samplers import parse_sampler
from anchorflow_benchmarks.scene_files import load_scenes
from anchorflow_cli.options import folder_option
from anchorflow_client.contract import AnchorRequest, ModelCard
from anchorflow_client.http import AnchorClient
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle

RESULTS = Path("benchmarks/results")
STUDENT = DEFAULT_BUNDLE.parent / "student"
SCENES = "FILE|drawn:N:SEED"

BundleOption = Annotated[Path, typer.Option(help="Folder of the bundle.")]
BundlesOption = Annotated[
    list[Path] | None,
    typer.Option("--bundle", help="Folder of a bundle; repeatable.", show_default="that ships"),
]
ScenesOption = Annotated[
    str, typer.Option(metavar=SCENES, help="Scenes: a .npz file, or drawn ones.")
]
NumOption = Annotated[int, typer.Option(min=1, max=512, help="Anchors a request.")]
SamplerOption = Annotated[str, typer.Option(help="card, rk4:8step, midpoint:uniform2, …")]
SamplersOption = Annotated[
    str, typer.Option(metavar="A,B", help="card, rk4:8step, rk4:uniform8, midpoint:uniform2, …")
]
ClientsOption = Annotated[int, typer.Option(min=1, help="Closed-loop clients.")]
ThreadsOption = Annotated[
    int | None, typer.Option(min=1, help="Threads of a request.", show_default="the cores")
]
AlongRouteOption = Annotated[
    bool,
    typer.Option("--along-route", help="Each bundle drives twice: then by its route."),
]
RecordOption = Annotated[
    bool, typer.Option("--record", help="Put each bundle's figures into its manifest.")
]
OutOption = Annotated[Path, folder_option("Folder that the results are written to.")]


def requests_on(bundle: Bundle, scenes: str, *, num: int, sampler: str) -> list[AnchorRequest]:
    """A request for each of the scenes; raises `BenchmarkError` for an unknown sampler or file."""
    spec = parse_sampler(sampler, bundle.card)
    found = load_scenes(scenes, limits=limits_of(bundle))
    return [request_of(scene, num=num, seed=1, sampler=spec) for scene in found]


def first_card(url: str) -> ModelCard:
    """The card of a service's default model.

    Raises:
        TransportError: nobody answers there.
        BenchmarkError: it serves no model.
    """
    with AnchorClient(url) as client:
        for card in client.models():
            return card
    raise BenchmarkError(f"{url}: expected a service of a model, found none")


def whole_numbers(text: str, option: str) -> list[int]:
    """`1,16,64` as numbers above 0; raises `BenchmarkError`."""
    parts = text.split(",")
    if not all(part.isdecimal() and int(part) > 0 for part in parts):
        raise BenchmarkError(f"{option}: expected whole numbers above 0 such as 1,16, got {text!r}")
    return [int(part) for part in parts]
