"""What the commands' typer apps and options have in common."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from anchorflow_client.contract.ranges import NUM_STYLE
from anchorflow_client.contract.styles import STYLES

Vector = NDArray[np.float64]

BundleOption = Annotated[
    Path, typer.Option(help="Folder of the bundle.", show_default="the one that ships")
]


def command_app() -> typer.Typer:
    """A typer app as every command has it; errors are `main`'s to print."""
    # Markup would take the units in help texts, `[m]`, for tags.
    return typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


def finite(value: float) -> float:
    """Of an option whose number must have an end. Raises `typer.BadParameter`."""
    if not math.isfinite(value):
        raise typer.BadParameter(f"expected a finite number, got {value}")
    return value


PICTURE_SUFFIXES = (".png", ".svg")


def picture_path(text: str) -> Path:
    """The file of a picture to draw. Raises `typer.BadParameter` for another suffix."""
    path = Path(text)
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise typer.BadParameter(f"expected a file {' or '.join(PICTURE_SUFFIXES)}, got {text!r}")
    return path


def picture_option(what: str) -> Any:
    """An option of a picture's file, checked before any work is done."""
    suffixes = " or ".join(PICTURE_SUFFIXES)
    return typer.Option(parser=picture_path, metavar="PATH", help=f"{what}, {suffixes}.")


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


PLACE, VELOCITY = "X,Y[,HEADING]", "VX,VY[,RATE]"

StartOption = Annotated[
    Vector,
    vector_option(PLACE, "Start [m], in the map's frame; heading [rad] where the model has one."),
]
GoalOption = Annotated[Vector, vector_option(PLACE, "Goal [m], likewise.")]
StartVelocityOption = Annotated[
    Vector | None, vector_option(VELOCITY, "Velocity at the start [m/s, rad/s]; default 0.")
]
GoalVelocityOption = Annotated[
    Vector | None, vector_option(VELOCITY, "Velocity at the goal [m/s, rad/s]; default 0.")
]
STYLE = "NAME|S,E,M"


def style_weights(text: str) -> Vector:
    """[3] of a named style, or the weights themselves. Raises `typer.BadParameter`."""
    if text in STYLES:
        return np.array(STYLES[text])
    try:
        values = np.array([float(part) for part in text.split(",")])
    except ValueError:
        values = np.empty(0)
    if values.size != NUM_STYLE or not np.isfinite(values).all():
        names = ", ".join(STYLES)
        raise typer.BadParameter(f"expected {NUM_STYLE} weights S,E,M or {names}, got {text!r}")
    return values


def style_text(style: Vector | None) -> str:
    """A style by its name where it has one, else by its weights."""
    if style is None:
        return "balanced"
    named = [name for name, weights in STYLES.items() if np.allclose(weights, style / style.sum())]
    return named[0] if named else ",".join(f"{weight:g}" for weight in style)


StyleOption = Annotated[
    Vector | None,
    typer.Option(
        parser=style_weights,
        metavar=STYLE,
        help=f"{', '.join(STYLES)}, or weights of safety, energy and smoothness.",
        show_default="balanced",
    ),
]
ON_CARD = "within the range on the model's card"
VMaxOption = Annotated[
    float | None, typer.Option(help=f"Greatest speed [m/s], {ON_CARD}.", show_default="the card's")
]
AMaxOption = Annotated[
    float | None,
    typer.Option(help=f"Greatest acceleration [m/s²], {ON_CARD}.", show_default="the card's"),
]
RadiusOption = Annotated[
    float | None,
    typer.Option(
        "--radius",
        "--robot-radius",
        help=f"The robot's radius [m], {ON_CARD}.",
        show_default="the card's",
    ),
]
HorizonOption = Annotated[
    float | None,
    typer.Option(
        help=f"Duration [s] of every anchor, {ON_CARD}.",
        show_default="each its own, or the card's",
    ),
]
NumSamplesOption = Annotated[int, typer.Option(help="How many anchors.")]
SeedOption = Annotated[int | None, typer.Option(help="Seed of the noise; drawn by default.")]
UnknownIsFreeOption = Annotated[
    bool, typer.Option("--unknown-is-free", help="Let the way lead through unknown cells.")
]


def end_states(
    start: Vector, goal: Vector, start_velocity: Vector | None, goal_velocity: Vector | None
) -> tuple[Vector, Vector]:
    """x_curr [3D] and x_goal [2D]; the robot starts unaccelerated, and at rest unless told."""
    rest = np.zeros_like(start)
    x_curr = np.concatenate([start, rest if start_velocity is None else start_velocity, rest])
    return x_curr, np.concatenate([goal, rest if goal_velocity is None else goal_velocity])
