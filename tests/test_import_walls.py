"""The import walls: packages that each package may import, in its text and when loaded."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# Imports of each package besides the standard library and itself.
WALLS: dict[str, set[str]] = {
    "anchorflow_client": {"numpy"},
    "anchorflow_trajectory": {"numba", "numpy"},
    "anchorflow_control": {"anchorflow_client", "anchorflow_trajectory", "numba", "numpy"},
    "anchorflow_ros": {
        "anchorflow_client",
        "anchorflow_control",
        "numpy",
        # ROS, whose packages are named after their messages
        "builtin_interfaces",
        "diagnostic_msgs",
        "geometry_msgs",
        "nav_msgs",
        "rcl_interfaces",
        "rclpy",
        "sensor_msgs",
        "std_msgs",
        "std_srvs",
        "trajectory_msgs",
        "visualization_msgs",
    },
    "anchorflow_driving": {"anchorflow_client", "anchorflow_trajectory", "numpy", "scipy"},
    "anchorflow_service": {
        "anchorflow_client",
        "anchorflow_trajectory",
        "numpy",
        "onnxruntime",
        "fastapi",
        "starlette",  # what fastapi's requests and responses are made of
        "uvicorn",
        "httptools",  # the HTTP under uvicorn
        "prometheus_client",
        "pydantic",
        "orjson",
        "PIL",
    },
    "anchorflow_models": {
        "anchorflow_client",
        "anchorflow_trajectory",
        "numpy",
        "torch",
        "torchdiffeq",
        "transformers",  # ResNet, imported where one is made
    },
    "anchorflow_training": {
        "anchorflow_client",
        "anchorflow_driving",
        "anchorflow_models",
        "anchorflow_trajectory",
        "numpy",
        "scipy",
        "torch",
        "h5py",  # trajectory files
        "transformers",  # pretrained weights, imported where they are read
        "safetensors",  # their files
        "pydantic",  # settings
        "yaml",  # configurations
        "lightning_fabric",
        "matplotlib",  # pictures, imported where one is drawn
    },
    "anchorflow_export": {
        "anchorflow_client",
        "anchorflow_models",
        "anchorflow_service",
        "anchorflow_trajectory",
        "numpy",
        "onnx",
        "onnxruntime",
        "onnxscript",
        "torch",
    },
    "anchorflow_benchmarks": {
        "anchorflow_cli",  # options of commands
        "anchorflow_client",
        "anchorflow_control",
        "anchorflow_driving",
        "anchorflow_ros",  # recorded drives
        "anchorflow_service",
        "anchorflow_training",
        "anchorflow_trajectory",
        "matplotlib",
        "numpy",
        "ompl",
        "onnx",
        "onnxruntime",
        "pytorch_mppi",  # the closed loop's controller
        "pyrvo",  # the people of simulated rooms
        "rich",  # tables
        "scipy",
        "threadpoolctl",
        "torch",
        "typer",
    },
}
# Optional dependencies of single modules or folders.
EXCEPTIONS = {
    "anchorflow_client.base_client": {"typing_extensions"},  # read by type checkers alone
    "anchorflow_client.ros_map": {"PIL", "yaml"},
    "anchorflow_client.zenoh_client": {"zenoh"},
    "anchorflow_ros.services": {"anchorflow_service"},  # a service in the node's own process
    "anchorflow_ros.replay": {"rosbags"},
    "anchorflow_ros.simulation": {"anchorflow_benchmarks", "scipy"},
    "anchorflow_ros.simulator": {"anchorflow_benchmarks", "rosgraph_msgs"},
    "anchorflow_driving.importers.argoverse": {"pyarrow"},
    "anchorflow_driving.sensors.bev": {"PIL"},
    "anchorflow_driving.cooperative": {"PIL", "moderngl"},
    "anchorflow_driving.sensors.cameras": {"moderngl"},
    "anchorflow_driving.sensors.recorded_camera": {"PIL"},
    "anchorflow_driving.sensors.rendering": {"moderngl"},
    "anchorflow_driving.simulation": {"libsumo", "sumo"},
    "anchorflow_models.generation": {"anchorflow_service"},  # runs the service's samplers
    "anchorflow_models.v2x_vlm": {"transformers"},
    "anchorflow_training.v2x": {"anchorflow_driving", "PIL", "tokenizers", "transformers"},
    "anchorflow_benchmarks.report": {"anchorflow_export"},  # --record
    "anchorflow_benchmarks.checkpoints": {"anchorflow_export"},  # random requests
    "anchorflow_benchmarks.published": {"anchorflow_export"},  # likewise
    "anchorflow_service.engine.conditioning.vision_language": {"tokenizers"},
    "anchorflow_service.zenoh_endpoint": {"zenoh"},
    "anchorflow_service.observability.spans": {"opentelemetry"},
    "anchorflow_trajectory.drawing": {"matplotlib"},
    "anchorflow_service.ray_app": {"ray"},
}

# Packages that a process must not load unless a wall allows them.
HEAVY = {
    "fastapi",
    "matplotlib",
    "numba",
    "onnx",
    "onnxruntime",
    "pydantic",
    "ray",
    "scipy",
    "torch",
    "typer",
}


def source_folder(package: str) -> Path:
    return ROOT / package.removeprefix("anchorflow_") / package


def module_name(path: Path, package: str) -> str:
    parts = path.relative_to(source_folder(package)).with_suffix("").parts
    return ".".join([package, *(part for part in parts if part != "__init__")])


def imported_packages(source: str) -> Iterator[str]:
    """Yield the top-level package of every import, in functions and TYPE_CHECKING too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.partition(".")[0]


def imported_modules(source: str, known: Collection[str]) -> Iterator[str]:
    """Yield the project's modules that a text imports, in functions and TYPE_CHECKING too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module in known:
            inner = (f"{node.module}.{alias.name}" for alias in node.names)
            yield from (name if name in known else str(node.module) for name in inner)


def import_circle(sources: Mapping[str, str], packages: Collection[str]) -> list[str]:
    """Return neighbours in one folder that import each other in a circle.

    Imports of a folder's modules from outside it count as the folder's; its `__init__` is a
    neighbour like any other.

    sources: text by module; packages: modules that are folders
    """
    neighbours: defaultdict[str, set[str]] = defaultdict(set)
    for module, source in sources.items():
        for other in set(imported_modules(source, sources)) - {module}:
            here, there = (
                [*name.split("."), *(["__init__"] if name in packages else [])]
                for name in (module, other)
            )
            depth = next(i for i, (a, b) in enumerate(zip(here, there, strict=False)) if a != b)
            end = depth + 1
            neighbours[".".join(here[:end])].add(".".join(there[:end]))
    try:
        TopologicalSorter(neighbours).prepare()
    except CycleError as circle:
        return circle.args[1]
    return []


def forbidden_imports(source: str, package: str, *, module: str = "") -> set[str]:
    allowed = WALLS[package] | exception_of(module) | {package}
    return set(imported_packages(source)) - allowed - sys.stdlib_module_names


def exception_of(module: str) -> set[str]:
    """Return the imports allowed to a module beyond its package's wall."""
    inside = (name for name in EXCEPTIONS if f"{module}.".startswith(f"{name}."))
    return set().union(*(EXCEPTIONS[name] for name in inside))


def reachable(package: str) -> set[str]:
    """Return the packages that it may load: its own wall, and those of its imports."""
    own = WALLS.get(package, set())
    return own.union(*(reachable(name) for name in own))


@cache
def loaded_packages(package: str) -> set[str]:
    """Import every module of a package in a fresh interpreter; return all top-level packages.

    scipy is hidden unless it is allowed: numba loads it if it can, and works without.
    """
    modules = [
        name
        for path in sorted(source_folder(package).rglob("*.py"))
        if not exception_of(name := module_name(path, package))
    ]
    hidden = [] if reachable(package) & {"scipy", "torchdiffeq"} else ["scipy"]
    program = f"""
import importlib, json, sys
sys.modules.update(dict.fromkeys({hidden!r}))
for name in {modules!r}:
    importlib.import_module(name)
loaded = [name for name, module in sys.modules.items() if module is not None]
print(json.dumps(sorted({{name.partition(".")[0] for name in loaded}})))
"""
    answer = subprocess.run(
        [sys.executable, "-c", program], check=False, capture_output=True, text=True
    )
    assert answer.returncode == 0, answer.stderr
    return set(json.loads(answer.stdout))


@pytest.mark.parametrize("package", WALLS)
def test_the_text_imports_only_what_the_wall_allows(package: str) -> None:
    paths = sorted(source_folder(package).rglob("*.py"))

    assert paths
    for path in paths:
        module = module_name(path, package)
        assert forbidden_imports(path.read_text(), package, module=module) == set(), module


@pytest.mark.parametrize(
    ("package", "source", "forbidden"),
    [
        ("anchorflow_client", "import numpy, json\nfrom . import codec", set()),
        ("anchorflow_client", "import scipy.ndimage", {"scipy"}),
        ("anchorflow_client", "import zenoh", {"zenoh"}),
        ("anchorflow_service", "def late():\n    from torch import nn", {"torch"}),
        ("anchorflow_service", "import anchorflow_models.flowmp", {"anchorflow_models"}),
        ("anchorflow_models", "import onnxruntime as ort", {"onnxruntime"}),
        ("anchorflow_driving", "import scipy, libsumo\nimport torch", {"libsumo", "torch"}),
        (
            "anchorflow_trajectory",
            "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import torch",
            {"torch"},
        ),
    ],
)
def test_a_forbidden_import_is_found(package: str, source: str, forbidden: set[str]) -> None:
    assert forbidden_imports(source, package) == forbidden


@pytest.mark.parametrize("package", WALLS)
def test_no_circle_of_imports(package: str) -> None:
    paths = list(source_folder(package).rglob("*.py"))
    folders = {module_name(path, package) for path in paths if path.name == "__init__.py"}
    sources = {module_name(path, package): path.read_text() for path in paths}
    assert import_circle(sources, folders) == []


@pytest.mark.parametrize(
    ("sources", "circle"),
    [
        ({"p": "from p.a import x", "p.a": "import p.b", "p.b": ""}, set()),
        ({"p": "", "p.a": "import p.b", "p.b": "from p import a"}, {"p.a", "p.b"}),
        ({"p": "", "p.a": "if TYPE_CHECKING:\n  import p.b", "p.b": "import p.a"}, {"p.a", "p.b"}),
        ({"p": "from p.a import x", "p.a": "from p import x"}, {"p.__init__", "p.a"}),
        # Two folders, although no file of theirs is in a circle.
        (
            {"p": "", "p.f.a": "import p.g.a", "p.g.a": "", "p.g.b": "import p.f.b", "p.f.b": ""},
            {"p.f", "p.g"},
        ),
    ],
)
def test_a_circle_is_found(sources: dict[str, str], circle: set[str]) -> None:
    assert set(import_circle(sources, {"p"})) == circle


@pytest.mark.parametrize(
    ("module", "forbidden"),
    [
        ("anchorflow_client.zenoh_client", set()),
        ("anchorflow_client.zenoh_client.session", set()),
        ("anchorflow_client.zenoh_messages", {"zenoh"}),
        ("anchorflow_client.codec", {"zenoh"}),
    ],
)
def test_only_the_named_package_has_its_exception(module: str, forbidden: set[str]) -> None:
    assert forbidden_imports("import zenoh", "anchorflow_client", module=module) == forbidden


def test_the_client_and_the_service_load_no_zenoh() -> None:
    for package in ("anchorflow_client", "anchorflow_service"):
        assert "zenoh" not in loaded_packages(package)


@pytest.mark.parametrize(
    "package",
    [
        "anchorflow_client",
        "anchorflow_trajectory",
        "anchorflow_control",
        "anchorflow_driving",
        "anchorflow_service",
    ],
)
def test_loading_the_package_loads_nothing_heavy_beyond_its_wall(package: str) -> None:
    loaded = loaded_packages(package)

    assert package in loaded
    assert loaded & (HEAVY - reachable(package)) == set()


def test_the_networks_load_no_server() -> None:
    assert loaded_packages("anchorflow_models") & {"fastapi", "onnxruntime", "pydantic"} == set()


def test_loading_is_seen() -> None:
    """The probe above finds what a package does load."""
    assert {"numba", "numpy"} <= loaded_packages("anchorflow_trajectory")


def test_a_blocking_robot_does_not_load_an_event_loop() -> None:
    """asyncio costs a seventh of the client's own import."""
    program = "import sys, anchorflow_client; sys.exit('asyncio' in sys.modules)"

    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
