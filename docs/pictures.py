"""Draw the pictures of the documentation: `python docs/pictures.py [NAME …]` after `make toolkit`.

They stand in `docs/images/`, each for light pages and for dark ones, drawn from the default bundle
on scenes of the project's own generator. Without names all are drawn.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from anchorflow_docs.pictures import (
    classes,
    drive,
    fields,
    flow,
    overview,
    pipeline,
    styles,
    training,
    warm_starts,
)
from anchorflow_docs.pictures.scenes import Stage
from anchorflow_docs.pictures.theme import Drawing, save
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine

IMAGES = Path(__file__).parent / "images"
SEED = 2026

PICTURES: dict[str, Callable[[Stage], Drawing]] = {
    "front": overview.front,
    "anchors": overview.anchors,
    "loss": training.loss,
    "pipeline": pipeline.pipeline,
    "fields": fields.fields,
    "flow": flow.flow,
    "styles": styles.styles,
    "classes": classes.classes,
    "warm_start": warm_starts.warm_start,
    "drive": drive.drive,
}


def main(names: Sequence[str]) -> None:
    """Draw these, or all."""
    if strangers := set(names) - set(PICTURES):
        raise SystemExit(f"pictures: expected {', '.join(PICTURES)}, got {', '.join(strangers)}")
    IMAGES.mkdir(exist_ok=True)
    stage = Stage(Engine(load_bundle(DEFAULT_BUNDLE)), SEED)
    for name in names or PICTURES:
        save(IMAGES / f"{name}.png", PICTURES[name](stage))


if __name__ == "__main__":
    main(sys.argv[1:])
