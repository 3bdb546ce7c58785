"""Options that give a robot an outline and wheels."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import typer

from anchorflow_cli.options import ANGLE, Vector, vector_option
from anchorflow_client.base_client import BaseClient
from anchorflow_client.contract import AnchorBatch
from anchorflow_client.contract.body import (
    DEFAULT_OMEGA_MAX,
    KINDS,
    Kinematics,
    read_footprint,
)
from anchorflow_client.contract.checks import EVERY_NUMBER
from anchorflow_client.errors import InvalidRequest

RECTANGLE = re.compile(r"\s*([\d.]+)\s*[x×]\s*([\d.]+)\s*")
FOOTPRINT = "LENGTHxWIDTH|CORNERS"
DISC_CORNERS = 48


def footprint(text: str) -> Vector:
    """Return the corners [K, 2] m of `0.9x0.62`, of `x,y x,y x,y` or of Nav2's `[[x, y], …]`."""
    try:
        return read_footprint(_corners(text))
    except InvalidRequest as error:
        raise typer.BadParameter(f"{error.message}; in {text!r}") from error
    except ValueError as error:
        raise typer.BadParameter(
            f"expected 0.9x0.62, or corners such as '0.4,0.3 -0.4,0.3 -0.4,-0.3 0.4,-0.3', "
            f"got {text!r}"
        ) from error


def _corners(text: str) -> Any:
    if found := RECTANGLE.fullmatch(text):
        front, left = (float(side) / 2 for side in found.groups())
        return [[front, left], [-front, left], [-front, -left], [front, -left]]
    if text.lstrip().startswith("["):
        return json.loads(text)
    pairs = (corner.split(",") for corner in text.split())
    return [[float(x), float(y)] for x, y in pairs]


FootprintOption = Annotated[
    Any,
    typer.Option(
        parser=footprint,
        metavar=FOOTPRINT,
        help="Outline [m]: length and width about the robot's origin, or the corners of a convex "
        "polygon, 'X,Y X,Y X,Y', x forward. By default a disc of --radius.",
    ),
]


def kind_of_wheels(text: str) -> str:
    """Check the kind of kinematics; raise `typer.BadParameter` otherwise."""
    if text not in KINDS:
        raise typer.BadParameter(f"expected one of {', '.join(KINDS)}, got {text!r}")
    return text


KinematicsOption = Annotated[
    str | None,
    typer.Option(
        parser=kind_of_wheels,
        metavar="|".join(KINDS),
        help="How the robot moves: any way, along its heading and turning on the spot, or like a "
        "car.",
        show_default="omni",
    ),
]
TurningRadiusOption = Annotated[
    float | None,
    typer.Option("--min-turning-radius", help="Radius [m] of the tightest turn of the wheels."),
]
OmegaMaxOption = Annotated[
    float | None,
    typer.Option(
        "--omega-max",
        help="Greatest turn rate [rad/s] of the wheels.",
        show_default=f"{DEFAULT_OMEGA_MAX:g}",
    ),
]
ReverseOption = Annotated[
    bool, typer.Option("--reverse", help="Let the wheels drive backwards too.")
]
GoalToleranceOption = Annotated[
    Vector | None,
    vector_option(
        f"POSITION[,{ANGLE}]",
        "Distance [m] at which another place may stand for an occupied goal; for a robot with a "
        "heading, also the angle to the goal's heading that is near enough [rad, or such as "
        "10deg].",
        EVERY_NUMBER,
        show_default="exact",
    ),
]


@dataclass(frozen=True)
class BodyChoice:
    """The robot's outline and wheels, as the options say."""

    footprint: Vector | None
    kinematics: Kinematics | None

    @classmethod
    def of(
        cls,
        outline: Vector | None,
        kind: str | None,
        *,
        min_turning_radius: float | None,
        omega_max: float | None,
        reverse: bool,
    ) -> BodyChoice:
        """Check the options; raise `typer.BadParameter` for wheels without their kind."""
        wheels = {
            "min_turning_radius": min_turning_radius,
            "omega_max": omega_max,
            "reverse": reverse or None,
        }
        given = {name: value for name, value in wheels.items() if value is not None}
        if kind is None:
            if given:
                option = f"--{next(iter(given))}".replace("_", "-")
                raise typer.BadParameter(f"expected --kinematics with {option}, got none")
            return cls(outline, None)
        return cls(outline, Kinematics.from_fields({"kind": kind, **given}))

    @property
    def has_heading(self) -> bool:
        """Whether its anchors are poses."""
        wheels = self.kinematics is not None and self.kinematics.kind != "omni"
        return wheels or self.footprint is not None

    def ends(self, start: Vector, goal: Vector) -> tuple[Vector, Vector, bool]:
        """Return start and goal, and whether the heading of the goal counts.

        A goal X,Y may be reached at any heading; a start has to have one.
        """
        if not self.has_heading:
            return start, goal, goal.size > 2
        if start.size < 3:
            message = "expected X,Y,HEADING for a robot with an outline or wheels"
            place = ",".join(f"{number:g}" for number in start)
            raise typer.BadParameter(f"{message}, got {place!r}", param_hint="'--start'")
        return start, np.append(goal, np.zeros(3 - goal.size)), goal.size > 2

    def tolerance(self, asked: Vector | None, *, heading_counts: bool) -> dict[str, Any] | None:
        """Return `goal_tolerance` of a request: a goal's own heading counts unless told more."""
        if asked is None and (heading_counts or not self.has_heading):
            return None
        position, *turn = [0.0] if asked is None else asked.tolist()
        if not turn and self.has_heading and heading_counts:
            turn = [0.0]
        return {"position": position, "heading": turn[0] if turn else None}

    def outline(self, client: BaseClient, anchors: AnchorBatch, radius: float | None) -> Any:
        """Return the outline [K, 2] m of poses, of a robot without a footprint a disc, or None."""
        if self.footprint is not None or not self.has_heading:
            return self.footprint
        if radius is None:
            card = next(card for card in client.models() if card.name == anchors.model.name)
            radius = card.cost_map.limits.robot_radius
        angle = np.linspace(0.0, 2.0 * np.pi, DISC_CORNERS, endpoint=False)
        return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
