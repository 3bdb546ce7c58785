"""What the commands' typer apps and options have in common."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

Vector = NDArray[np.float64]

BundleOption = Annotated[
    Path, typer.Option(help="Folder of the bundle.", show_default="the one that ships")
]


def command_app() -> typer.Typer:
    """A typer app as every command has it; errors are `main`'s to print."""
    # Markup would take the units in help texts, `[m]`, for tags.
    return typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


def vector_option(metavar: str, help_text: str) -> Any:
    """An option of numbers, `--start 1.5,-2`: as many as the metavar (`X,Y[,HEADING]`) has parts.

    Parts in brackets may be left out, all of them.
    """
    most, least = (len(part.split(",")) for part in (metavar, metavar.partition("[")[0]))
    counts = f"{least}" if least == most else f"{least} or {most}"

    def vector(text: str) -> Vector:
        try:
            values = np.array([float(part) for part in text.split(",")])
        except ValueError:
            values = np.empty(0)
        if values.size not in (least, most) or not np.isfinite(values).all():
            raise typer.BadParameter(f"expected {counts} numbers {metavar}, got {text!r}")
        return values

    return typer.Option(parser=vector, metavar=metavar, help=help_text)
