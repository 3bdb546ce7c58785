"""What a reader has at hand where a command begins: maps, files, bundles, certificates."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import yaml
from PIL import Image

from anchorflow_docs.commands.printed import ROOT
from anchorflow_docs.programs import programs_of

SHIPPED = ROOT / "service" / "anchorflow_service" / "bundles"
# A router of the same library, in the place of zenohd; it says that it is up on a line of its own.
ROUTER_PROGRAM = """
import signal, threading
from anchorflow_client.zenoh_client import ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
session = open_session(ZenohSettings(mode="router", listen=("tcp/127.0.0.1:7447",)))
signal.signal(signal.SIGINT, signal.SIG_DFL)
print("router at tcp/127.0.0.1:7447", flush=True)
threading.Event().wait()
"""


def program(folder: Path) -> None:
    """`ask.py`: the first program of the front page."""
    first = programs_of(ROOT / "docs" / "index.md")[0]
    (folder / "ask.py").write_text(first.text)


def scene(folder: Path) -> None:
    """What the page saves: the JSON of a request."""
    fields = {
        "cost_map": {"data": np.zeros((1, 64, 64)).tolist(), "resolution": 0.16},
        "x_curr": [-3, 0, 0, 0, 0, 0],
        "x_goal": [3, 1, 0, 0],
        "num_samples": 4,
    }
    (folder / "anchorflow-scene.json").write_text(json.dumps(fields))


def ros_map(folder: Path) -> None:
    """A free map of 12 x 10 m in a wall."""
    pixels = np.full((200, 240), 254, dtype=np.uint8)
    pixels[[0, -1]] = pixels[:, [0, -1]] = 0
    Image.fromarray(pixels).save(folder / "map.png")
    fields = {"image": "map.png", "resolution": 0.05, "origin": [0, 0, 0], "negate": 0}
    fields |= {"occupied_thresh": 0.65, "free_thresh": 0.25}
    (folder / "map.yaml").write_text(yaml.safe_dump(fields))


def bundles(folder: Path) -> None:
    """A repository of one model."""
    shutil.copytree(SHIPPED / "default", folder / "bundles" / "flowmp-small" / "0.3.0")


def two_bundles(folder: Path) -> None:
    """`bundles/a` and `bundles/b`."""
    shutil.copytree(SHIPPED / "default", folder / "bundles" / "a")
    shutil.copytree(SHIPPED / "student", folder / "bundles" / "b")


def certificate(folder: Path) -> None:
    """`cert.pem` and `key.pem` for this machine."""
    import trustme  # a test's own

    issued = trustme.CA().issue_cert("localhost", "127.0.0.1")
    issued.private_key_pem.write_to_path(folder / "key.pem")
    for pem in issued.cert_chain_pems:
        pem.write_to_path(folder / "cert.pem", append=True)


def router(folder: Path) -> None:
    """`router.py`."""
    (folder / "router.py").write_text(ROUTER_PROGRAM)


def repository(folder: Path) -> None:
    """A git repository with the configuration of pre-commit."""
    subprocess.run(["git", "init", "--quiet", str(folder)], check=True)
    shutil.copy(ROOT / ".pre-commit-config.yaml", folder)


def trajectories(folder: Path) -> None:
    """`my.npz`: trajectories of somebody's own."""
    along = np.linspace(0.0, 1.0, 45)
    aside = np.linspace(-1.0, 1.0, 32)[:, None] * np.sin(np.pi * along)
    positions = np.stack([np.broadcast_to(3.0 * along, aside.shape), aside], axis=-1)
    np.savez(folder / "my.npz", positions=positions)


def training(folder: Path) -> None:
    """`data/train`, the dataset of the small planner, and the `train.yaml` that the page prints."""
    shutil.copytree(folder / "data" / "small", folder / "data" / "train")
    page = (ROOT / "docs" / "training.md").read_text()
    (printed,) = re.findall(r"^```yaml\n(# train\.yaml\n.*?)^```$", page, re.DOTALL | re.MULTILINE)
    (folder / "train.yaml").write_text(printed)


def runs(folder: Path) -> None:
    """The small planner's run in the place of those that take hours."""
    for run in ("runs/default", "runs/student", "runs/first", "runs/second", "my_run"):
        shutil.copytree(folder / "runs" / "small", folder / run)
