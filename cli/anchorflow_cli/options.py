"""Typer apps and options that several commands share."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from typer.core import TyperCommand

from anchorflow_client.contract import Obstacles
from anchorflow_client.contract.checks import Interval
from anchorflow_client.contract.fields import (
    COORDINATE,
    DEFAULT_COST_PENALTY,
    MAX_CHANNELS,
    NUM_STYLE,
    STYLES,
    VELOCITY,
)
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.http.transport import Address

Vector = NDArray[np.float64]

BundleOption = Annotated[
    Path | None, typer.Option(help="Folder of the bundle.", show_default="the one that ships")
]


class FiniteCommand(TyperCommand):
    """A command that refuses nan and inf, which pass the bounds of an option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        rest = super().parse_args(ctx, args)
        for option in self.params:
            given = ctx.params.get(option.name)
            for value in given if isinstance(given, list) else [given]:
                if isinstance(value, float) and not math.isfinite(value):
                    said = f"expected a finite number, got {value}"
                    raise typer.BadParameter(said, ctx=ctx, param_hint=f"'{option.opts[0]}'")
        return rest


class CommandApp(typer.Typer):
    """A typer app of `FiniteCommand`s."""

    def command(self, name: str | None = None, **settings: Any) -> Any:
        return super().command(name, cls=FiniteCommand, **settings)


def command_app() -> CommandApp:
    """Make the typer app of a command; `main` prints errors."""
    # Markup would read units in help texts, `[m]`, as tags.
    return CommandApp(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


def new_folder(text: str | Path) -> Path:
    """Check for a folder that exists or can be made; raise `typer.BadParameter` otherwise."""
    return _place(text, "a folder", is_wrong=lambda path: path.exists() and not path.is_dir())


def new_file(text: str | Path) -> Path:
    """Check for a file that can be written; raise `typer.BadParameter` otherwise."""
    return _place(text, "a file", is_wrong=Path.is_dir)


def _place(text: str | Path, what: str, *, is_wrong: Callable[[Path], bool]) -> Path:
    path = Path(text)
    if text == "":
        raise typer.BadParameter(f"expected {what} to write, got ''")
    if is_wrong(path):
        found = "a folder" if path.is_dir() else "a file"
        raise typer.BadParameter(f"expected {what} to write, got {path}, which is {found}")
    nearest = next(each for each in path.absolute().parents if each.exists())
    if not nearest.is_dir():
        raise typer.BadParameter(f"expected {what} to write, got {path}: {nearest} is a file")
    if not path.exists() and not os.access(nearest, os.W_OK):
        raise typer.BadParameter(f"expected {what} to write, got {path}: {nearest} is read-only")
    return path


def folder_option(help_text: str, **settings: Any) -> Any:
    """Return an option for an output folder, checked before any work."""
    return typer.Option(parser=new_folder, metavar="PATH", help=help_text, **settings)


def file_option(help_text: str, **settings: Any) -> Any:
    """Return an option for an output file, checked before any work."""
    return typer.Option(parser=new_file, metavar="PATH", help=help_text, **settings)


def service_url(text: str) -> str:
    """Check the URL of a service; raise `typer.BadParameter` if it is none."""
    try:
        Address.of(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    return text


def url_option(help_text: str, **settings: Any) -> Any:
    """Return an option for a service's URL."""
    return typer.Option(parser=service_url, metavar="URL", help=help_text, **settings)


PICTURE_SUFFIXES = (".png", ".svg")


def picture_path(text: str) -> Path:
    """Check for a picture that can be written; raise `typer.BadParameter` otherwise."""
    if Path(text).suffix.lower() not in PICTURE_SUFFIXES:
        raise typer.BadParameter(f"expected a file {' or '.join(PICTURE_SUFFIXES)}, got {text!r}")
    return new_file(text)


def picture_option(what: str) -> Any:
    """Return an option for a picture, checked before any work."""
    suffixes = " or ".join(PICTURE_SUFFIXES)
    return typer.Option(parser=picture_path, metavar="PATH", help=f"{what}, {suffixes}.")


ANGLE = "HEADING"
"""A part of a metavar that is in rad, or in degrees with `deg`."""


def _number(text: str, *, is_angle: bool) -> float:
    if is_angle and text.endswith("deg"):
        return math.radians(float(text.removesuffix("deg")))
    return float(text)


def vector_option(metavar: str, help_text: str, interval: Interval, **settings: Any) -> Any:
    """Return an option for numbers such as `--start 1.5,-2`, one per part of the metavar.

    The parts in brackets are optional together; each number is checked against the interval.
    """
    most, least = (len(part.split(",")) for part in (metavar, metavar.partition("[")[0]))
    counts = f"{least}" if least == most else f"{least} or {most}"
    names = re.findall(r"\w+", metavar)

    def vector(text: str) -> Vector:
        parts = enumerate(text.split(","))
        try:
            values = np.array(
                [_number(part, is_angle=names[k : k + 1] == [ANGLE]) for k, part in parts]
            )
        except ValueError:
            values = np.empty(0)
        if values.size not in (least, most) or not np.isfinite(values).all():
            raise typer.BadParameter(f"expected {counts} numbers {metavar}, got {text!r}")
        if not interval.holds_all(values):
            raise typer.BadParameter(f"expected numbers {interval}, got {text!r}")
        return values

    return typer.Option(parser=vector, metavar=metavar, help=help_text, **settings)


PLACE, RATE = f"X,Y[,{ANGLE}]", "VX,VY[,RATE]"

StartOption = Annotated[
    Vector,
    vector_option(
        PLACE,
        "Start [m], in the map's frame; for a robot with a heading also that, in rad, or in "
        "degrees as 90deg.",
        COORDINATE,
    ),
]
GoalOption = Annotated[
    Vector, vector_option(PLACE, "Goal [m], likewise; without a heading any will do.", COORDINATE)
]
StartVelocityOption = Annotated[
    Vector | None, vector_option(RATE, "Velocity at the start [m/s, rad/s]; default 0.", VELOCITY)
]
GoalVelocityOption = Annotated[
    Vector | None, vector_option(RATE, "Velocity at the goal [m/s, rad/s]; default 0.", VELOCITY)
]
STYLE = "NAME|S,E,M"


def style_weights(text: str) -> Vector:
    """Return the weights [3] of a style by name or number; raise `typer.BadParameter`."""
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
    """Return the name of a style, or its weights without a name."""
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
LAYERS = {"traversability": 1, "risk": 2}
"""Channels by name."""


def layer_file(text: str) -> tuple[int, Path]:
    """Parse `CHANNEL=FILE`."""
    name, _, file = text.partition("=")
    channel = LAYERS.get(name, int(name) if name.isdecimal() else 0)
    if not (0 < channel < MAX_CHANNELS and file):
        names = ", ".join(LAYERS)
        raise typer.BadParameter(
            f"expected {names} or a channel up to {MAX_CHANNELS - 1}, =, and a file, got {text!r}"
        )
    return channel, Path(file)


LayerOption = Annotated[
    list[Any] | None,
    typer.Option(
        "--layer",
        parser=layer_file,
        metavar="CHANNEL=FILE",
        help="A grey picture of the map's size, white for 1: traversability, risk, or 3 and up; "
        "repeatable.",
    ),
]


def tracks_file(text: str) -> Obstacles:
    """Read the obstacles in a file; raise `typer.BadParameter` if there are none."""
    try:
        return Obstacles.from_fields(json.loads(Path(text).read_text(encoding="utf-8")))
    except OSError as error:
        raise typer.BadParameter(f"{text}: {error.strerror}") from error
    except ValueError as error:
        raise typer.BadParameter(f"{text}: expected JSON, got {error}") from error
    except InvalidRequest as error:
        raise typer.BadParameter(f"{text}: {error}") from error


ObstaclesOption = Annotated[
    Any,
    typer.Option(
        "--obstacles",
        parser=tracks_file,
        metavar="FILE",
        help="JSON of what moves: position and velocity [M,2], radius [M], as in a request.",
    ),
]
PenaltyOption = Annotated[
    float | None,
    typer.Option(
        "--cost-penalty",
        help="Metres of detour that a metre through soft cost 1 is worth.",
        show_default=f"{DEFAULT_COST_PENALTY:g}",
    ),
]


UnknownIsFreeOption = Annotated[
    bool, typer.Option("--unknown-is-free", help="Let the way lead through unknown cells.")
]


def end_states(
    start: Vector, goal: Vector, start_velocity: Vector | None, goal_velocity: Vector | None
) -> tuple[Vector, Vector]:
    """Return x_curr [3D] and x_goal [2D], at rest by default, with zero acceleration."""
    rest = np.zeros_like(start)
    x_curr = np.concatenate([start, _moving(start_velocity, rest), rest])
    return x_curr, np.concatenate([goal, _moving(goal_velocity, rest)])


def _moving(velocity: Vector | None, rest: Vector) -> Vector:
    """Return a velocity, with a turn rate of 0 if a state with a heading has none."""
    if velocity is None:
        return rest
    return np.append(velocity, rest[velocity.size :])
