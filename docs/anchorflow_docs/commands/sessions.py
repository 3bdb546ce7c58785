"""What a reader would type: the printed commands in sessions, each in a folder with what it needs.

`QUICK` needs no more than the tests' own environment; each has a test. `WALKTHROUGH` goes on in one
fresh checkout, installs and trains there, and is what `make walkthrough` runs. `NOT_HERE` says why
the rest is not run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from anchorflow_docs.commands import given

READY = "curl -s http://127.0.0.1:8000/v2/health/ready"
PLAN = (
    "python3 - <<'PY' | curl -s http://127.0.0.1:8000/anchors"
    " -H 'Content-Type: application/json' -d @-"
)
SHIPPED = "service/anchorflow_service/bundles"
LOAD = "curl -X POST localhost:8000/v2/repository/models/flowmp-small/load"
REPLICA = "--zenoh client --zenoh-connect tcp/127.0.0.1:7447 --zenoh-replica"


@dataclass(frozen=True)
class Session:
    """Commands by their names, in order; servers among them go on until its end.

    given: what makes the files that they need, in the session's folder
    before: what is typed first and printed nowhere
    needs: a module without which it is skipped
    """

    name: str
    commands: tuple[str, ...]
    given: tuple[Callable[[Path], None], ...] = ()
    before: tuple[str, ...] = ()
    needs: str | None = None


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
        (given.scene, given.program),
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
        (given.bundles,),
    ),
    Session(
        "bundles", ("anchorflow serve --bundle bundles/a --bundle bundles/b",), (given.two_bundles,)
    ),
    Session(
        "both", (f"anchorflow serve --bundle {SHIPPED}/default --bundle {SHIPPED}/student", PLAN)
    ),
    Session("compiled loops", ("python -m anchorflow_trajectory.warm_up",)),
    Session("student", (f"anchorflow serve --bundle {SHIPPED}/student", PLAN)),
    *(
        Session(name, (f"anchorflow serve --bundle {SHIPPED}/{name}", READY))
        for name in ("goalflow", "wote", "diffusiondrive", "v2x")
    ),
    Session("workers", ("anchorflow serve --workers 2", PLAN)),
    Session("any address", ("anchorflow serve --host 0.0.0.0", PLAN)),
    Session(
        "operations",
        (
            "anchorflow token tokens robot-7",
            "anchorflow serve --host 0.0.0.0 --tokens tokens --tls-cert cert.pem --tls-key key.pem"
            " --log-format json --log-level info --notice-s 5 --drain-s 15",
        ),
        (given.certificate,),
    ),
    Session("traces", ("anchorflow serve --traces http://127.0.0.1:4318/v1/traces", READY)),
    Session("zenoh", ("anchorflow serve --zenoh peer", READY)),
    Session(
        "replicas",
        (f"anchorflow serve --port 8001 {REPLICA} a", f"anchorflow serve --port 8002 {REPLICA} b"),
        (given.router,),
        before=("python router.py",),
    ),
    Session(
        "a map",
        (".venv/bin/anchorflow plan --map map.yaml --start 2.0,3.5 --goal 9.0,6.0 --out plan.png",),
        (given.ros_map,),
    ),
    Session(
        "simulated driving",
        (
            "anchorflow data drive --out drive --logs 2",
            "anchorflow data frames drive/simulated-0-00000.npz"
            f" --bundle {SHIPPED}/goalflow --out drive.json",
        ),
        needs="libsumo",
    ),
    Session("hooks", (".venv/bin/pre-commit install",), (given.repository,)),
    Session("Ray Serve", ON_RAY, needs="ray.serve"),
)

WALKTHROUGH = (
    Session("start", ("make serve", READY, PLAN), before=("make .venv/.service",)),
    Session("another port", ("make serve PORT=8001",)),
    Session(
        "a small planner",
        (
            "make toolkit",
            ".venv/bin/anchorflow data make data/small --scenes 400",
            ".venv/bin/anchorflow train data/small --out runs/small --steps 600 --samples 16",
            ".venv/bin/anchorflow generate --checkpoint runs/small/checkpoint.pt --start 0,0"
            " --goal 6,1 --plot small.png",
            ".venv/bin/anchorflow export runs/small/checkpoint.pt --out bundles/small --name small",
            ".venv/bin/anchorflow serve --bundle bundles/small",
            PLAN,
        ),
    ),
    Session(
        "drivers on simulated logs",
        (
            "pip install -e '.[train,driving,bench]'",
            "anchorflow data drive --out drive --logs 2",
            f"anchorflow bench drive --logs drive --bundle {SHIPPED}/goalflow --out runs/drive",
        ),
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
        (given.training, given.runs),
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
        (given.trajectories,),
    ),
    Session(
        "what else there is to install",
        (
            ".venv/bin/pip install -e '.[service,plot]'",
            "pip install -e '.[service]'",
            "pip install -e '.[bench]'",
            "pip install -e '.[robot]'",
            "pip install .",
            "pip install '.[zenoh]'",
            "pip install '.[service,zenoh]'",
            "pip install '.[service]'",
            "pip install '.[service,otel]'",
            "pip install '.[service,language]'",
            "pip install '.[plot]'",
            "pip install playwright",
        ),
    ),
    Session(
        "a robot",
        (
            "pip install '.[robot]'",
            "anchorflow serve",
            "python examples/robot/robot.py --record robot.gif",
        ),
    ),
    Session("on Ray Serve", ("pip install '.[ray]'", *ON_RAY)),
)

BY_CI = ("make lint", "make format", "make test", "make docs", "make image", "make walkthrough")
"""What `.ci/run` itself types."""

OTHERS_LOGS = "needs a recording that others publish; tests/driving/importers makes one"
MEASURES = "measures for minutes, on all cores; tests/benchmarks runs it on less"
TRAINS = "trains for the better part of an hour or more"
DRAWS = "draws and solves scenes for a quarter of an hour"
ENGINE = "needs a container engine; `make image` builds and runs the same Dockerfile with buildah"
SCREEN = "needs a screen"

NOT_HERE = {
    "make bench": MEASURES,
    "anchorflow bench quality": MEASURES,
    "anchorflow bench quality --bundle bundles/a --bundle bundles/b"
    " --samplers card,rk4:8step,rk4:uniform8,midpoint:uniform2 --baselines expert,lines,routes,rrt"
    " --scenes ../shared/data/scenes_public.npz --limit 60": MEASURES,
    "anchorflow bench quality --bundle whole --bundle rounded": MEASURES,
    "anchorflow bench quality --scenes ../shared/data/forests_public.npz"
    " --routes ../shared/data/forest_routes_public.npz": MEASURES,
    "anchorflow bench latency": MEASURES,
    "anchorflow bench latency --provider cuda": "needs a GPU",
    "anchorflow bench latency --checkpoint runs/default/checkpoint.pt"
    " --samplers rk4:8step,card": MEASURES,
    f"anchorflow bench latency --bundle {SHIPPED}/default --bundle {SHIPPED}/student"
    " --samplers card --scenes drawn:8:3 --rounds 16": MEASURES,
    "anchorflow bench load": MEASURES,
    "anchorflow bench load --url http://127.0.0.1:8000": MEASURES,
    "anchorflow bench zenoh": MEASURES,
    "anchorflow bench zenoh --sampler midpoint:uniform2": MEASURES,
    f"anchorflow bench zenoh --bundle {SHIPPED}/student --rounds 300": MEASURES,
    "anchorflow bench earns --limit 60": MEASURES,
    "anchorflow bench closed-loop ../shared/data/barn_public.npz --motions 128,512": MEASURES,
    "anchorflow bench closed-loop ../shared/data/forests_public.npz --motions 128,512": MEASURES,
    f"anchorflow bench closed-loop ../shared/data/barn_public.npz --bundle {SHIPPED}/student"
    " --motions 128,512 --seeds 3 --sampler card --latency-ms 100": MEASURES,
    "anchorflow bench drive --logs ../shared/data/driving": MEASURES,
    f"anchorflow bench drive-closed-loop --bundle {SHIPPED}/goalflow --along-route": MEASURES,
    "anchorflow data import-log USA_US101-1_1_T-1.xml --out us101.npz": OTHERS_LOGS,
    "anchorflow data import-log nuscenes --scene scene-0061 --out 0061.npz": OTHERS_LOGS,
    "anchorflow data import-log scenario_0a0a.parquet --out av2.npz": OTHERS_LOGS,
    "anchorflow data import-log 2021.06.14.pkl --unpickle --map map.gpkg --scene 3f1b"
    " --out navsim.npz": OTHERS_LOGS,
    "anchorflow bench drive --logs ../shared/data/driving --drivers none"
    " --bundle bundles/goalflow"
    " --samplers euler:uniform1,euler:uniform5,euler:uniform20": MEASURES,
    "anchorflow train data/drive --planner goalflow --out runs/goalflow --steps 1700"
    " --batch.scenes 16 --batch.samples 6 --objective.scored 40 --augmentation.moved 0.35"
    " --model.channels 16": TRAINS,
    "anchorflow train data/drive --planner goalflow --out runs/outcomes"
    " --before runs/goalflow/checkpoint.pt --objective.stage outcomes --model.outcomes"
    " --model.channels 16 --steps 1000 --batch.scenes 16": TRAINS,
    "anchorflow bench drive-closed-loop --drivers none --bundle bundles/goalflow --along-route"
    " --seed 9000 --keep data/outcomes --out runs/drives": MEASURES,
    "cp data/drive/*.npz data/outcomes": "copies to where the line above it has driven",
    "anchorflow train data/outcomes --planner goalflow --out runs/again"
    " --before runs/outcomes/checkpoint.pt --objective.stage outcomes --model.outcomes"
    " --model.channels 16 --steps 1000 --batch.scenes 16 --learning-rate 0.001": TRAINS,
    "anchorflow export runs/outcomes/checkpoint.pt --out bundles/goalflow": (
        "exports the run that the line above it trains; tests/service/http exports a smaller one"
    ),
    "anchorflow serve --bundle bundles/goalflow": (
        "serves what the lines above it make; the one that ships is served by its own session"
    ),
    "anchorflow bench drive --logs ../shared/data/driving --bundle bundles/wote": MEASURES,
    "anchorflow data drive --out drive --logs 300": DRAWS,
    "anchorflow data drive --out data/drive --logs 24": DRAWS,
    "anchorflow data anchors drive --out anchors.npy": DRAWS,
    "anchorflow data sensors drive --config examples/wote-small.yaml": DRAWS,
    "anchorflow train drive --config examples/wote-small.yaml --anchors anchors.npy"
    " --out runs/wote": TRAINS,
    "anchorflow bench drive-closed-loop --drivers none --bundle bundles/wote --along-route"
    " --seed 9000 --keep drive --out runs/drives": MEASURES,
    "anchorflow train drive --config examples/wote-small.yaml --before runs/wote/checkpoint.pt"
    " --objective.moved --out runs/again": TRAINS,
    "anchorflow export runs/wote/checkpoint.pt --out bundles/wote": (
        "needs what the training above leaves; tests/service/http/test_wote_bundle.py exports one"
    ),
    "anchorflow train drive --config examples/diffusiondrive-small.yaml --out runs/together"
    " --perception runs/wote/checkpoint.pt --frozen-perception": TRAINS,
    "anchorflow train drive --config examples/diffusiondrive-small.yaml --out runs/scorers"
    " --before runs/together/checkpoint.pt --objective.stage scorers --objective.groups 0"
    " --steps 200": TRAINS,
    "anchorflow export runs/scorers/checkpoint.pt --out bundles/diffusiondrive": (
        "needs what the training above leaves; tests/export exports one of random weights"
    ),
    "anchorflow bench drive --logs ../shared/data/driving"
    " --bundle bundles/diffusiondrive": MEASURES,
    f"anchorflow bench pairs {SHIPPED}/v2x": MEASURES,
    ".venv/bin/anchorflow train data/pairs --planner v2x_vlm --out runs/v2x --steps 2600"
    " --batch.scenes 16 --learning-rate 5e-4 --warmup 100 --loss.alignment 0"
    " --loss.location 1 --roadside-dropout 0.2": TRAINS,
    "python examples/quickstart.py --out runs/quickstart": (
        "trains for two minutes; tests/test_quickstart.py runs it on less"
    ),
    "anchorflow data make data/default --scenes 10000 --seed 1": DRAWS,
    "anchorflow data make data/train --scenes 20000": DRAWS,
    "anchorflow train data/default --out runs/default --steps 6000 --bfloat16 --threads 1"
    " --batch.samples 24 --model.layers 3 --evaluation.held-out 64": TRAINS,
    "anchorflow train data/train --out runs/first --held-out 500 --steps 12000": TRAINS,
    "anchorflow train data/train --out runs/second --config train.yaml --batch.samples 16"
    " --flow.flow-time late": TRAINS,
    "anchorflow train my_data --out my_run": TRAINS,
    "anchorflow distill runs/default/checkpoint.pt data/default --out runs/student --steps 3500"
    " --bfloat16 --threads 1 --teacher.scenes 4000 --teacher.steps 3 --noise-scale 1.4"
    " --cost-weight 0.3 --model.layers 2": TRAINS,
    "anchorflow distill runs/first/checkpoint.pt data/train --out runs/student": TRAINS,
    "docker build --file docker/Dockerfile --tag anchorflow .": ENGINE,
    "docker run --read-only --tmpfs /tmp --cap-drop ALL --publish 127.0.0.1:8000:8000"
    " anchorflow": ENGINE,
    "docker compose --file docker/compose.yaml up --build": (
        "needs a container engine; tests/docker holds the file to the commands' options"
    ),
    "docker build --file docker/Dockerfile --tag anchorflow:cuda"
    " --build-arg BASE_IMAGE=nvidia/cuda:13.0.1-cudnn-runtime-ubuntu24.04"
    " --build-arg ONNXRUNTIME=onnxruntime-gpu .": "needs a container engine and a GPU",
    "docker run --gpus all --publish 127.0.0.1:8000:8000 anchorflow:cuda"
    " serve --host 0.0.0.0 --provider cuda": "needs a container engine and a GPU",
    "zenohd -c examples/zenoh/router.json5": (
        "needs zenohd, which is no package of Python's; the tests' router is the library's own"
    ),
    "python examples/robot/robot.py --view": SCREEN,
    "python examples/robot/robot.py --zenoh tcp/127.0.0.1:7447 --view": SCREEN,
}
