"""Make the drives that the page opens planners without a map with: `python docs/page_samples.py`.

street.json     a simulated drive through a left turn, for GoalFlow, WoTE and DiffusionDriveV2
crossing.json   a synthetic crossing seen by a car and from the roadside, for V2X-VLM
"""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import typer

from anchorflow_client.contract import TensorSpec
from anchorflow_driving.cooperative.crossings import CAR, LANE, draw_crossing
from anchorflow_driving.drive_file import drive_file, packed, rounded, windows_on_the_way
from anchorflow_driving.geometry import Array, into_frame, out_of_frame
from anchorflow_driving.log import read_log
from anchorflow_driving.simulation import LogConfig
from anchorflow_driving.simulation.make_logs import make_logs
from anchorflow_driving.window import Vehicle
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.http.page import FOLDER
from anchorflow_training.v2x.text import prompt

SAMPLES = FOLDER / "samples"
SEED, LOG, FRAMES = 1, 2, 10
"""Of the simulated logs: a car that turns left behind others."""
CROSSING_SEED = 8
STEP_S = 0.1
ROAD = 90.0
"""m of each road before and behind the crossing."""


def street() -> dict[str, Any]:
    """Return a drive with the inputs of every planner for cars that takes sensors."""
    cards = [load_bundle(DEFAULT_BUNDLE.parent / name).card for name in ("goalflow", "wote")]
    specs = {spec.name: spec for card in cards for spec in card.inputs}
    with TemporaryDirectory() as folder:
        make_logs(Path(folder), LogConfig(seed=SEED), logs=LOG + 1, workers=1)
        log = read_log(sorted(Path(folder).glob("*.npz"))[LOG])
    drive, frames = drive_file(windows_on_the_way(log, every_s=1.0), [*specs.values()], of="street")
    return drive | {"frames": [frame for frame, _ in zip(frames, range(FRAMES), strict=False)]}


def crossing() -> dict[str, Any]:
    """Return a drive in which a house hides the crossing car from the ego."""
    drawn = draw_crossing(CROSSING_SEED, size=(256, 160), every=2)
    first, vehicle = drawn.frames[0].pose, Vehicle(*CAR)
    poses = np.stack([frame.pose for frame in drawn.frames])
    specs = {
        name: TensorSpec(name, dtype, ("B", *shape))
        for name, dtype, shape in (
            ("vehicle_image", "uint8", (3, 160, 256)),
            ("infrastructure_image", "uint8", (3, 160, 256)),
            ("prompt", "text", ()),
        )
    }
    arm = np.array([[ROAD, -LANE], [ROAD, LANE], [LANE, LANE]])
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    roads = np.concatenate([arm @ np.linalg.matrix_power(quarter.T, k) for k in range(4)])
    middle = np.array([[-ROAD, 0.0], [ROAD, 0.0]])

    def lines(*each: Array) -> list[list[float]]:
        placed = (into_frame(out_of_frame(line, drawn.junction), first) for line in each)
        return [rounded(line.ravel()) for line in placed]

    frames = []
    for number, frame in enumerate(drawn.frames):
        if frame.vehicle_image is None or frame.infrastructure_image is None:
            continue
        speed = float(np.linalg.norm(poses[number, :2] - poses[number - 1, :2])) / STEP_S
        seen = {
            "vehicle_image": frame.vehicle_image,
            "infrastructure_image": frame.infrastructure_image,
        }
        later = poses[number + 5 : number + 46 : 5]
        boxes = np.concatenate([into_frame(frame.boxes[:, :3], frame.pose), frame.boxes[:, 3:]], 1)
        frames.append(
            {
                "time_s": round(frame.time_s, 3),
                "pose": rounded(into_frame(frame.pose, first), digits=4),
                "recorded": rounded(into_frame(later, frame.pose), digits=3),
                "boxes": [[*box, 0] for box in rounded(boxes)],
                "inputs": {name: packed(image, specs[name]) for name, image in seen.items()}
                | {"prompt": prompt(speed=speed, turn_rate=0.0, scene="")},
            }
        )
    return {
        "format": "anchorflow-drive",
        "version": 1,
        "log": f"crossing-{CROSSING_SEED}",
        "source": "simulated",
        "licence": "none",
        "track": 0,
        "bundle": "v2x",
        "inputs": [
            {"name": spec.name, "dtype": spec.dtype, "shape": list(spec.shape[1:])}
            for spec in specs.values()
        ],
        "ego": rounded(np.array([vehicle.rear_axle, 0.0, 0.0, *vehicle.size])),
        "map": {
            "drivable": lines(roads),
            "crosswalk": [],
            "line": [],
            "centre": lines(middle, middle[:, ::-1]),
        },
        "frames": frames,
    }


def main() -> None:
    """Write both drives beside the page."""
    SAMPLES.mkdir(exist_ok=True)
    for make in (street, crossing):
        path = SAMPLES / f"{make.__name__}.json"
        path.write_text(json.dumps(make(), separators=(",", ":"), allow_nan=False))
        typer.echo(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
