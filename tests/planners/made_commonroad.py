"""A CommonRoad scenario: a street, a bend to the left in a junction, a street."""

from __future__ import annotations

from pathlib import Path

import numpy as np

STEP, SPEED, RADIUS, STRAIGHT, WIDTH = 0.2, 8.0, 20.0, 80.0, 4.0
BEND = RADIUS * np.pi / 2


def place(s: float, left: float = 0.0) -> tuple[float, float, float]:
    """x, y, heading at an arc length of the street, so far to its left."""
    if s < STRAIGHT:
        x, y, heading = s, 0.0, 0.0
    elif s < STRAIGHT + BEND:
        heading = (s - STRAIGHT) / RADIUS
        x, y = STRAIGHT + RADIUS * np.sin(heading), RADIUS * (1 - np.cos(heading))
    else:
        x, y, heading = STRAIGHT + RADIUS, RADIUS + s - STRAIGHT - BEND, np.pi / 2
    return x - left * np.sin(heading), y + left * np.cos(heading), heading


def points(begin: float, end: float, left: float) -> str:
    at = (place(s, left) for s in np.linspace(begin, end, 25))
    return "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x, y, _ in at)


def lanelet(name: int, begin: float, end: float, after: str = "") -> str:
    sides = {"left": WIDTH / 2, "right": -WIDTH / 2}
    bounds = "".join(
        f"<{side}Bound>{points(begin, end, left)}<lineMarking>solid</lineMarking></{side}Bound>"
        for side, left in sides.items()
    )
    return f'<lanelet id="{name}">{bounds}{after}<laneletType>urban</laneletType></lanelet>'


def state(tag: str, step: int, s: float, speed: float) -> str:
    x, y, heading = place(s)
    return (
        f"<{tag}><position><point><x>{x}</x><y>{y}</y></point></position>"
        f"<orientation><exact>{heading}</exact></orientation><time><exact>{step}</exact></time>"
        f"<velocity><exact>{speed}</exact></velocity></{tag}>"
    )


def obstacle(name: int, kind: str, shape: str, states: str) -> str:
    return (
        f'<dynamicObstacle id="{name}"><type>{kind}</type><shape>{shape}</shape>'
        f"{states}</dynamicObstacle>"
    )


CAR = "<rectangle><length>4.5</length><width>1.8</width></rectangle>"


def recording() -> dict[str, str]:
    driven = "".join(state("state", k, 5 + SPEED * STEP * k, SPEED) for k in range(1, 90))
    walked = "".join(state("state", k, 60.0, 0.0) for k in range(1, 40))
    car = state("initialState", 0, 5.0, SPEED) + f"<trajectory>{driven}</trajectory>"
    walker = state("initialState", 0, 60.0, 0.0) + f"<trajectory>{walked}</trajectory>"
    walker = walker.replace("<y>0.0</y>", "<y>5.0</y>")
    text = (
        '<commonRoad commonRoadVersion="2020a" benchmarkID="MADE_Up-1_1_T-1"'
        f' timeStepSize="{STEP}">'
        + lanelet(1, 0, STRAIGHT, '<successor ref="2"/>')
        + lanelet(2, STRAIGHT, STRAIGHT + BEND, '<predecessor ref="1"/><successor ref="3"/>')
        + lanelet(3, STRAIGHT + BEND, 220.0)
        + obstacle(10, "car", CAR, car)
        + obstacle(11, "pedestrian", "<circle><radius>0.3</radius></circle>", walker)
        + '<intersection id="20"><incoming id="21"><incomingLanelet ref="1"/>'
        '<successorsLeft ref="2"/></incoming></intersection></commonRoad>'
    )
    return {"xml": text}


def write(folder: Path, made: dict[str, str]) -> Path:
    path = folder / "made.xml"
    path.write_text(made["xml"])
    return path
