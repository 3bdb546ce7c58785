"""Run the printed commands in sessions, each in a folder with the files that it needs.

`QUICK` sessions run in the tests. `WALKTHROUGH` sessions install and train in one fresh checkout,
by `make walkthrough`. `NOT_RUN` has the reasons why other commands are not run.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from PIL import Image

from anchorflow_docs.commands.printed import ROOT, printed_texts
from anchorflow_docs.page_blocks import programs_of

BUNDLES = ROOT / "service" / "anchorflow_service" / "bundles"
DEPOT = Path(
    os.environ.get("ANCHORFLOW_SHARED_DATA", ROOT.parent / "shared/data"), "maps/depot.yaml"
)
READY = "curl -s http://127.0.0.1:8000/v2/health/ready"
PLAN = (
    "python3 - <<'PY' | curl -s http://127.0.0.1:8000/anchors"
    " -H 'Content-Type: application/json' -d @-"
)
SHIPPED = "service/anchorflow_service/bundles"
ALL = ("default", "student", "goalflow", "wote", "diffusiondrive", "v2x")
LOAD = "curl -X POST localhost:8000/v2/repository/models/flowmp-small/load"
REPLICA = "--zenoh client --zenoh-connect tcp/127.0.0.1:7447 --zenoh-replica"
# A router by zenoh's Python library in place of zenohd; it prints a line when it is up.
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
    """Write `ask.py` and `ask_zenoh.py`, the first programs of two pages."""
    for name, page in (("ask.py", "index.md"), ("ask_zenoh.py", "zenoh.md")):
        (folder / name).write_text(programs_of(ROOT / "docs" / page)[0].text)


def scene(folder: Path) -> None:
    """Write the JSON of a request, as the page saves it."""
    fields = {
        "cost_map": {"data": np.zeros((1, 64, 64)).tolist(), "resolution": 0.16},
        "x_curr": [-3, 0, 0, 0, 0, 0],
        "x_goal": [3, 1, 0, 0],
        "num_samples": 4,
    }
    (folder / "anchorflow-scene.json").write_text(json.dumps(fields))


def ros_map(folder: Path) -> None:
    """Write a free map of 12 x 10 m inside a wall."""
    pixels = np.full((200, 240), 254, dtype=np.uint8)
    pixels[[0, -1]] = pixels[:, [0, -1]] = 0
    Image.fromarray(pixels).save(folder / "map.png")
    fields = {"image": "map.png", "resolution": 0.05, "origin": [0, 0, 0], "negate": 0}
    fields |= {"occupied_thresh": 0.65, "free_thresh": 0.25}
    (folder / "map.yaml").write_text(yaml.safe_dump(fields))


def bundles(folder: Path) -> None:
    """Write a repository with one model."""
    shutil.copytree(BUNDLES / "default", folder / "bundles" / "flowmp-small" / "0.3.0")


def two_bundles(folder: Path) -> None:
    """Write `bundles/a` and `bundles/b`."""
    shutil.copytree(BUNDLES / "default", folder / "bundles" / "a")
    shutil.copytree(BUNDLES / "student", folder / "bundles" / "b")


def certificate(folder: Path) -> None:
    """Write `cert.pem` and `key.pem` for this machine."""
    import trustme  # only tests install it

    issued = trustme.CA().issue_cert("localhost", "127.0.0.1")
    issued.private_key_pem.write_to_path(folder / "key.pem")
    for pem in issued.cert_chain_pems:
        pem.write_to_path(folder / "cert.pem", append=True)


def router(folder: Path) -> None:
    """Write `router.py`."""
    (folder / "router.py").write_text(ROUTER_PROGRAM)


def repository(folder: Path) -> None:
    """Make a git repository with the configuration of pre-commit."""
    subprocess.run(["git", "init", "--quiet", str(folder)], check=True)
    shutil.copy(ROOT / ".pre-commit-config.yaml", folder)


def trajectories(folder: Path) -> None:
    """Write `my.npz`, a file of trajectories."""
    along = np.linspace(0.0, 1.0, 45)
    aside = np.linspace(-1.0, 1.0, 32)[:, None] * np.sin(np.pi * along)
    positions = np.stack([np.broadcast_to(3.0 * along, aside.shape), aside], axis=-1)
    np.savez(folder / "my.npz", positions=positions)


def training(folder: Path) -> None:
    """Copy the small planner's dataset to `data/train`, and write the page's `train.yaml`."""
    shutil.copytree(folder / "data" / "small", folder / "data" / "train")
    page = (ROOT / "docs" / "training.md").read_text()
    (printed,) = re.findall(r"^```yaml\n(# train\.yaml\n.*?)^```$", page, re.DOTALL | re.MULTILINE)
    (folder / "train.yaml").write_text(printed)


def runs(folder: Path) -> None:
    """Copy the small planner's run to the names of runs that take hours."""
    for run in ("runs/default", "runs/student", "runs/first", "runs/second", "my_run"):
        shutil.copytree(folder / "runs" / "small", folder / run)


@dataclass(frozen=True)
class Session:
    """Commands by their names, in order; servers run until the end of the session.

    given: functions that write the files that the commands need
    before: commands that run first and are printed nowhere
    needs: a module without which the session is skipped
    tool: a shell command without whose success the walkthrough skips the session
    """

    name: str
    commands: tuple[str, ...]
    given: tuple[Callable[[Path], None], ...] = ()
    before: tuple[str, ...] = ()
    needs: str | None = None
    tool: str = "true"


INSTALLS = re.compile(r"(\.venv/bin/)?pip install ")
FROM_WHEELS = (
    "python3 -m venv served",
    "served/bin/pip install 'dist/anchorflow-0.1.0-py3-none-any.whl[service]'",
    "python3 -m venv robot",
    "robot/bin/pip install 'dist/anchorflow_client-0.1.0-py3-none-any.whl[zenoh]'",
    "served/bin/anchorflow serve",
    "robot/bin/python ask.py",
)
ON_RAY = ("serve run anchorflow_service.ray_app:app max_replicas=8 cpus=2", READY, PLAN)

QUICK = (
    Session(
        "ask",
        (
            "anchorflow serve",
            READY,
            PLAN,
            "curl -H 'Content-Type: application/json' -d @anchorflow-scene.json"
            " http://127.0.0.1:8000/anchors",
            ".venv/bin/python ask.py",
        ),
        (scene, program),
    ),
    Session(
        "repository",
        (
            "anchorflow serve --repository bundles",
            "curl -X POST localhost:8000/v2/repository/index",
            f"{LOAD} -d '{{}}'",
            f'{LOAD} -d \'{{"parameters": {{"version": "0.3.0"}}}}\'',
            "curl -X POST localhost:8000/v2/repository/models/flowmp-small/unload",
        ),
        (bundles,),
    ),
    Session("bundles", ("anchorflow serve --bundle bundles/a --bundle bundles/b",), (two_bundles,)),
    Session(
        "both", (f"anchorflow serve --bundle {SHIPPED}/default --bundle {SHIPPED}/student", PLAN)
    ),
    Session(
        "compiled loops",
        ("python -m anchorflow_trajectory.warm_up", "python -m anchorflow_control.warm_up"),
    ),
    Session("a shipped bundle", (f"anchorflow serve --bundle {SHIPPED}/wote", READY)),
    Session("workers", ("anchorflow serve --workers 2", PLAN)),
    Session(
        "operations",
        (
            "anchorflow token tokens robot-7",
            "anchorflow serve --host 0.0.0.0 --tokens tokens --tls-cert cert.pem --tls-key key.pem"
            " --log-format json --log-level info --notice-s 5 --drain-s 15",
        ),
        (certificate,),
    ),
    Session("traces", ("anchorflow serve --traces http://127.0.0.1:4318/v1/traces", READY)),
    Session("zenoh", ("anchorflow serve --zenoh peer", READY)),
    Session(
        "replicas",
        (f"anchorflow serve --port 8001 {REPLICA} a", f"anchorflow serve --port 8002 {REPLICA} b"),
        (router,),
        before=("python router.py",),
    ),
    Session(
        "a map",
        (
            ".venv/bin/anchorflow plan --map map.yaml --start 2.0,3.5 --goal 9.0,6.0"
            " --out plan.png",
            "anchorflow plan --map map.yaml --start 2.0,3.5,90deg --goal 9.0,6.0,0"
            " --footprint 0.9x0.62 --kinematics differential --out plan.png",
        ),
        (ros_map,),
    ),
    Session("hooks", (".venv/bin/pre-commit install",), (repository,)),
    Session("Ray Serve", ON_RAY, needs="ray.serve"),
)

WALKTHROUGH = (
    Session(
        "start",
        ("make serve", READY, PLAN, ".venv/bin/python ask.py"),
        (program,),
        before=("make .venv/.service",),
    ),
    Session(
        "a depot",
        (),
        before=(f"anchorflow plan --map {DEPOT} --start 2,3.5 --goal 28,13",),
        tool=f"test -f {DEPOT}",
    ),
    Session(
        "over zenoh",
        (),
        (program,),
        before=(
            "pip install -e '.[service,zenoh]'",
            "anchorflow serve --zenoh peer",
            "python ask_zenoh.py",
        ),
    ),
    Session("any address", ("anchorflow serve --host 0.0.0.0", PLAN)),
    Session(
        "from C++",
        (
            "g++ -std=c++17 -O2 examples/cpp/anchors.cpp -lcurl -o anchors",
            "anchorflow serve",
            "./anchors http://127.0.0.1:8000",
        ),
        tool="echo '#include <curl/curl.h>' | g++ -x c++ -fsyntax-only -",
    ),
    Session("wheels", ("pip wheel --no-deps --wheel-dir dist . ./client ./trajectory ./control",)),
    Session("from wheels", FROM_WHEELS, (program,)),
    *(
        Session(
            f"from wheels on Python {version}",
            (),
            (program,),
            before=tuple(
                each.replace("python3 -m venv", f"python{version} -m venv --clear")
                for each in FROM_WHEELS
            ),
            tool=f"python{version} -c ''",
        )
        for version in ("3.10", "3.12", "3.13")
    ),
    Session("another port", ("make serve PORT=8001",)),
    Session(
        "a small planner",
        (
            "make toolkit",
            ".venv/bin/anchorflow data make data/small --scenes 400",
            ".venv/bin/anchorflow train data/small --out runs/small --steps 600 --samples 16"
            " --held-out 40",
            ".venv/bin/anchorflow generate --checkpoint runs/small/checkpoint.pt --start 0,0"
            " --goal 6,1 --plot small.png",
            ".venv/bin/anchorflow export runs/small/checkpoint.pt --out bundles/small --name small",
            ".venv/bin/anchorflow serve --bundle bundles/small",
            PLAN,
        ),
    ),
    Session(
        "the page",
        ("python docs/page_pictures.py http://127.0.0.1:8000 runs/page",),
        before=(
            "pip install playwright",
            "anchorflow serve --bundle " + " --bundle ".join(f"{SHIPPED}/{each}" for each in ALL),
        ),
        tool="which chromium",
    ),
    Session(
        "drivers on simulated logs",
        (
            "pip install -e '.[train,driving,bench]'",
            "anchorflow data drive --out drive --logs 2",
            "anchorflow data frames drive/simulated-0-00000.npz"
            f" --bundle {SHIPPED}/goalflow --out drive.json",
            f"anchorflow bench drive --logs drive --bundle {SHIPPED}/goalflow --out runs/drive",
        ),
    ),
    Session(
        "recorded sensors",
        (
            "anchorflow data import-log nuscenes --scene scene-0061 --sensors nuscenes"
            " --out recorded/scene-0061.npz",
            "anchorflow data import-log nuscenes --scene scene-0103 --sensors nuscenes"
            " --out recorded/scene-0103.npz",
            "anchorflow train recorded --config examples/wote-small.yaml --steps 10 --warmup 0"
            " --batch.scenes 2 --held-out 0 --out runs/recorded",
            "anchorflow export runs/recorded/checkpoint.pt --out bundles/recorded",
            "anchorflow bench drive --logs recorded --bundle bundles/recorded"
            " --out runs/recorded-drive",
            "anchorflow serve --bundle bundles/recorded",
        ),
        before=("python tests/planners/made_nuscenes.py nuscenes",),
    ),
    Session(
        "two cameras",
        (
            ".venv/bin/anchorflow data crossings data/crossings --scenes 20",
            ".venv/bin/anchorflow data verify data/crossings",
            ".venv/bin/anchorflow data pairs data/crossings data/pairs --image-size 96",
            ".venv/bin/anchorflow train data/pairs --planner v2x_vlm --out runs/v2x --steps 20",
            ".venv/bin/anchorflow export runs/v2x/checkpoint.pt --out bundles/v2x",
            ".venv/bin/anchorflow serve --bundle bundles/v2x",
        ),
    ),
    Session(
        "training",
        (
            "pip install -e '.[train]'",
            "anchorflow train data/train --config train.yaml --print-config",
            "tail -f runs/first/curve.jsonl",
            "tensorboard --logdir runs",
            "anchorflow average runs/first/checkpoint.pt runs/second/checkpoint.pt"
            " --out runs/mean.pt",
            "anchorflow export runs/first/checkpoint.pt --out bundles/first",
        ),
        (training, runs),
    ),
    Session(
        "a bundle for a GPU",
        (
            f"anchorflow export checkpoints/default.pt --like {SHIPPED}/default --float32"
            " --out bundles/whole",
        ),
    ),
    Session(
        "a student",
        (
            "anchorflow export runs/student/checkpoint.pt --out bundles/student"
            " --name flowmp-small-student",
            f"anchorflow export runs/default/checkpoint.pt --out {SHIPPED}/default"
            " --version 0.3.0 --noise-scale 1.4 --refine-steps 6 --refine-rate 0.12 --int8",
            f"anchorflow export runs/student/checkpoint.pt --out {SHIPPED}/student"
            " --name flowmp-small-student --version 0.3.0 --refine-steps 6 --refine-rate 0.12"
            " --int8",
        ),
    ),
    Session(
        "data of one's own",
        (
            "anchorflow data import my.npz my_data --dt 0.1",
            "anchorflow export my_run/checkpoint.pt --out my_bundle",
            "anchorflow serve --bundle my_bundle",
            PLAN,
        ),
        (trajectories,),
    ),
    Session(
        "a robot",
        (
            "pip install -e '.[robot]'",
            "anchorflow serve",
            "python examples/robot/robot.py --record robot.gif",
        ),
    ),
    Session("on Ray Serve", ("pip install -e '.[ray]'", *ON_RAY)),
    Session(
        "with ROS 2",
        (
            "pip install -e '.[ros,bench,service]'",
            "pip install -e '.[control]'",
            "pip install -e '.[bags]'",
            "python -m anchorflow_ros.node --ros-args"
            " -p goal.beyond_map:=approach -p map.timeout_s:=1.0",
            "python -m anchorflow_ros.simulator",
        ),
    ),
    Session("all that there is to install", tuple(filter(INSTALLS.match, printed_texts()))),
)

BY_CI = ("make lint", "make format", "make test", "make docs", "make image", "make walkthrough")
"""Commands of `.ci/run` itself."""

NOT_RUN = {
    r"kubectl ": "needs a cluster",
    r"make bench|anchorflow bench ": "runs for minutes on all cores; tests/benchmarks runs less",
    r"(\.venv/bin/)?anchorflow (train|distill) ": "trains for the better part of an hour or more",
    r"anchorflow data (make|drive|anchors|sensors) ": "draws scenes for a quarter of an hour",
    r"anchorflow data (descriptions|pairs) RECORDING ": "needs Florence-2; a test makes a tiny one",
    r"anchorflow data import-log ": "needs a published recording; its test makes one",
    rf"anchorflow checkpoint {SHIPPED}/": "takes as long as an export; tests/export reads less",
    rf"anchorflow serve --bundle {SHIPPED}/": "as WoTE's, which runs; other tests open them",
    r"anchorflow (export|serve) .*bundles/|cp data/drive": "needs the training above it",
    r"python docs/page_samples.py": "writes into the package; a test reads what it wrote",
    r"python examples/quickstart.py": "trains for two minutes; its test trains less",
    r"docker ": "needs a container engine; `make image` builds the same Dockerfile with buildah",
    r"zenohd ": "needs zenohd, which is not on PyPI; the tests' router is the library's own",
    r"python examples/robot/robot.py .*--view": "needs a screen",
    r"ln -s .*ros2_ws|cd ~/ros2_ws|ros2 (launch|bag) ": "needs a robot's ROS",
    r"anchorflow replay ": "needs a recorded bag; tests/ros makes one",
}
"""Reasons by a pattern of commands that no session runs."""


def reason_not_to_run(command: str) -> str | None:
    """Return why a command is in no session, or None."""
    return next((why for form, why in NOT_RUN.items() if re.match(form, command)), None)
