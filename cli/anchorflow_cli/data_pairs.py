"""`anchorflow data crossings`, `verify`, `descriptions`, `pairs`: data of V2X-VLM."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import Progress

from anchorflow_cli.options import new_file, new_folder
from anchorflow_training.v2x.dataset import make_pairs
from anchorflow_training.v2x.recording import verify_recording
from anchorflow_training.v2x.text import read_tokenizer

RecordingArgument = Annotated[
    Path, typer.Argument(metavar="DIR", help="cooperative-vehicle-infrastructure of DAIR-V2X.")
]


def crossings(
    out: Annotated[Path, typer.Argument(parser=new_folder, help="Folder to write.")],
    *,
    scenes: Annotated[int, typer.Option(min=1, help="How many.")] = 300,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same bytes.")] = 0,
) -> None:
    """Draw crossings that a house hides, as a car and a roadside camera see them."""
    from anchorflow_driving.cooperative.crossings import draw_crossings
    from anchorflow_driving.cooperative.layout import write_recording

    with Progress() as bar:
        drives = bar.track(draw_crossings(scenes, seed=seed), total=scenes, description="scenes")
        pairs = write_recording(out, drives)
    typer.echo(f"{out}: {scenes} sequences, {pairs} pairs")


def verify(recording: RecordingArgument) -> None:
    """Say what a cooperative recording lacks; every fault names its file."""
    with counted("pairs") as progress:
        verdict = verify_recording(recording, progress=progress)
    for line in verdict.lines:
        typer.echo(line)
    if verdict.faults:
        raise typer.Exit(1)


def descriptions(
    recording: RecordingArgument,
    out: Annotated[
        Path,
        typer.Argument(parser=new_file, help="File for `data pairs`; an existing one is resumed."),
    ],
    *,
    florence: Annotated[Path, typer.Option(help="Folder of a published Florence-2.")],
    image_size: Annotated[
        int, typer.Option(min=32, help="Pixels along a side; Florence-2's own are 768.")
    ] = 768,
) -> None:
    """Describe the car's pictures in up to 256 tokens each."""
    from anchorflow_training.v2x.captions import Captioner, describe_recording

    captioner = Captioner(florence, image_size=image_size)
    with counted("pictures") as progress:
        count = describe_recording(recording, out, captioner, progress=progress)
    typer.echo(f"{out}: {count} pictures")


def pairs(
    recording: RecordingArgument,
    out: Annotated[
        Path, typer.Argument(parser=new_folder, help="Folder to write, for `anchorflow train`.")
    ],
    *,
    image_size: Annotated[
        int, typer.Option(min=32, help="Pixels along a side; Florence-2's own are 768.")
    ] = 192,
    tokenizer: Annotated[
        Path | None,
        typer.Option(help="tokenizer.json, or a folder of it.", show_default="trained here"),
    ] = None,
    describe: Annotated[
        bool, typer.Option("--describe", help="Tell of the boxes around in the prompts.")
    ] = False,
    descriptions: Annotated[
        Path | None,
        typer.Option(help="File of `data descriptions`, for the prompts.", show_default="none"),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of which sequences are held out.")] = 0,
) -> None:
    """Make pairs of pictures, prompts and waypoints of a cooperative recording."""
    with counted("pairs") as progress:
        dataset = make_pairs(
            recording,
            out,
            image_size=image_size,
            tokenizer=None if tokenizer is None else read_tokenizer(tokenizer),
            describe=describe,
            descriptions=descriptions,
            seed=seed,
            progress=progress,
        )
    held_out = len(dataset.indices(held_out=True))
    typer.echo(
        f"{out}: {len(dataset)} pairs, {held_out} of them held out with "
        f"{len(dataset.meta['held_out'])} of {len(dataset.meta['names'])} sequences; "
        f"{dataset.vocabulary} tokens"
    )


@contextmanager
def counted(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar; the function yielded takes how many are done, and of how many."""
    with Progress() as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
