"""Draw the pictures of the documentation: `python docs/pictures.py [NAME …]` after `make toolkit`.

They are written to `docs/images/` for light and for dark pages, drawn with the default bundle on
scenes of the project's generator. Without names all are drawn.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from anchorflow_docs.pictures import answers, bodies, drive, stages
from anchorflow_docs.pictures.scenes import Stage
from anchorflow_docs.pictures.theme import Drawing, save
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine

IMAGES = Path(__file__).parent / "images"
SEED = 2026

PICTURES: dict[str, Callable[[Stage], Drawing]] = {
    "front": answers.front,
    "anchors": answers.anchors,
    "loss": answers.loss,
    "pipeline": stages.pipeline,
    "fields": stages.fields,
    "flow": stages.flow,
    "styles": answers.styles,
    "classes": answers.classes,
    "warm_start": answers.warm_start,
    "bodies": bodies.bodies,
    "drive": drive.drive,
}


def main(names: Sequence[str]) -> None:
    """Draw the pictures of these names, or all."""
    if unknown := set(names) - set(PICTURES):
        raise SystemExit(f"pictures: expected {', '.join(PICTURES)}, got {', '.join(unknown)}")
    IMAGES.mkdir(exist_ok=True)
    stage = Stage(Engine(load_bundle(DEFAULT_BUNDLE)), SEED)
    for name in names or PICTURES:
        save(IMAGES / f"{name}.png", PICTURES[name](stage))


if __name__ == "__main__":
    main(sys.argv[1:])
