"""`anchorflow bench pairs` and `bench florence`: V2X-VLM judged, and at its full size."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated, Literal

import typer

from anchorflow_cli.bench_options import RESULTS, OutOption, RecordOption, ThreadsOption
from anchorflow_cli.bench_output import progress, record, report, say
from anchorflow_cli.extras import needs_extra
from anchorflow_client.contract import VisionLanguageSpec
from anchorflow_service.local import LocalClient


def pairs(
    bundles: Annotated[list[Path], typer.Argument(help="Folders of V2X-VLM bundles.")],
    *,
    data: Annotated[
        Path | None,
        typer.Option(help="Folder of pairs; those held out are judged.", show_default="drawn"),
    ] = None,
    crossings: Annotated[int, typer.Option(min=2, help="Scenes drawn, without --data.")] = 200,
    threads: ThreadsOption = None,
    recorded: RecordOption = False,
    out: OutOption = RESULTS,
) -> None:
    """Judge V2X-VLM bundles by L2 and collisions, with and without the roadside picture."""
    with needs_extra("train", who="anchorflow bench pairs"):
        from anchorflow_benchmarks.driving.pairs import Group, judged_crossings, pair_tables
        from anchorflow_training.v2x.dataset import open_pairs
    asked = [LocalClient.of(bundle, threads=threads) for bundle in bundles]
    sizes = {client.engine.card.name: _image_size(client) for client in asked}
    if len({*sizes.values()}) > 1:
        raise typer.BadParameter(f"expected bundles asked with pictures of one size, got {sizes}")
    clients = {client.engine.card.name: client for client in asked}
    if len(clients) < len(bundles):
        raise typer.BadParameter(f"expected bundles of different names, got {', '.join(clients)}")
    with tempfile.TemporaryDirectory() as scratch:
        if data is None:
            (size,) = {*sizes.values()}
            dataset, groups = judged_crossings(Path(scratch), scenes=crossings, image_size=size)
        else:
            dataset = open_pairs(data)
            groups = [Group("Held out", dataset.indices(held_out=True))]
        with progress("pairs", 3 * len(clients) * len(groups[0].indices)) as advance:
            tables = pair_tables(clients, dataset, groups, progress=advance)
    judged = data.name if data else f"{crossings} drawn crossings"
    report("Pairs", {"bundles": ", ".join(clients), "pairs": judged}, tables, out)
    if recorded:
        record(zip(clients, bundles, strict=True), {"pairs": judged}, tables[0])


def _image_size(client: LocalClient) -> int:
    card = client.engine.card
    if not isinstance(card.conditioning, VisionLanguageSpec):
        kind = card.conditioning.kind
        raise typer.BadParameter(f"{card.name}: expected a bundle asked with pictures, got {kind}")
    return card.conditioning.image_size


def florence(
    *,
    variant: Annotated[Literal["base", "large"], typer.Option(help="Of Florence-2.")] = "base",
    train_vision: Annotated[
        bool, typer.Option("--train-vision", help="Train the tower too: twice the memory.")
    ] = False,
    out: OutOption = RESULTS,
) -> None:
    """Train V2X-VLM one step at its full size, with random weights, export and serve it."""
    with needs_extra("train", who="anchorflow bench florence"):
        from anchorflow_benchmarks.driving.florence_size import florence_size_table
    table = florence_size_table(variant, tell=say, freeze_vision=not train_vision)
    report("Florence", {"variant": variant}, [table], out)
