"""The files of the deployment agree with the command, the application and each other."""

from __future__ import annotations

import re
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from anchorflow_cli import serve
from anchorflow_service.http.tokens import scopes_for
from anchorflow_trajectory.warm_up import STILL, USUAL_S

ROOT = Path(__file__).resolve().parents[2]
DOCKER = ROOT / "docker"
PYPROJECT = (ROOT / "pyproject.toml").read_text()
DOCKERFILE = (DOCKER / "Dockerfile").read_text()
COMPOSE = yaml.safe_load((DOCKER / "compose.yaml").read_text())
RUNTIME, INFERENCE = yaml.safe_load_all((DOCKER / "kserve" / "anchorflow.yaml").read_text())
CONTAINER = RUNTIME["spec"]["containers"][0]
PLANNERS = ("planner-1", "planner-2")


def parsed(arguments: list[str]) -> dict[str, Any]:
    """The options of `anchorflow serve …` by name; typer's error if one is wrong."""
    name, *options = arguments
    assert name == "serve"
    command = typer.main.get_command(serve.app)
    return command.make_context("serve", options).params


def image_command() -> list[str]:
    (words,) = re.findall(r"^CMD \[(.+)\]$", DOCKERFILE, re.MULTILINE)
    return [word.strip().strip('"') for word in words.split(",")]


def files() -> list[Path]:
    return [path for path in sorted(DOCKER.rglob("*")) if path.is_file()]


def test_the_image_serves_on_the_port_that_it_exposes_and_checks() -> None:
    options = parsed(image_command())

    assert options["host"] == "0.0.0.0"
    assert f"\nEXPOSE {options['port']}\n" in DOCKERFILE
    assert f"ANCHORFLOW_URL=http://127.0.0.1:{options['port']}\n" in DOCKERFILE
    assert "ANCHORFLOW_URL" in DOCKERFILE.partition("HEALTHCHECK")[2]


def test_the_image_runs_as_nobodys_root() -> None:
    (user,) = re.findall(r"^USER (\d+):\d+$", DOCKERFILE, re.MULTILINE)

    assert int(user) > 0
    assert CONTAINER["securityContext"]["runAsUser"] == int(user)
    assert DOCKERFILE.index("\nUSER ") < DOCKERFILE.index("\nENTRYPOINT ")


def test_what_an_image_is_built_from_is_all_that_is_installed() -> None:
    lines = (ROOT / ".dockerignore").read_text().splitlines()
    let_in = [line[1:] for line in lines if line.startswith("!")]
    # By hand: Python 3.10 has no reader of TOML.
    (packages,) = re.findall(r"^packages = \[(.*?)\]", PYPROJECT, re.MULTILINE | re.DOTALL)
    (readme,) = re.findall(r'^readme = "(.+)"$', PYPROJECT, re.MULTILINE)
    (license_file,) = re.findall(r'^license-files = \["(.+)"\]$', PYPROJECT, re.MULTILINE)
    needed = [*re.findall(r'"(.+?)"', packages), readme, license_file, "pyproject.toml"]

    assert "*" in lines
    assert "service/anchorflow_service" in needed
    for path in needed:
        assert any(fnmatch(path, pattern) or path.startswith(f"{pattern}/") for pattern in let_in)


@pytest.mark.parametrize("name", PLANNERS)
def test_the_services_are_started_with_options_that_there_are(name: str) -> None:
    service = COMPOSE["services"][name]
    options = parsed(service["command"])

    (port,) = service["ports"]
    assert port.startswith("127.0.0.1:")
    assert port.endswith(f":{options['port']}")
    assert options["zenoh_connect"] == ["tcp/router:7447"]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    stop_s = float(service["stop_grace_period"].removesuffix("s"))
    assert stop_s > options["notice_s"] + options["drain_s"]


def test_every_port_is_published_on_this_machine_alone() -> None:
    for service in COMPOSE["services"].values():
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", []))


def test_prometheus_asks_every_service_and_grafana_asks_prometheus() -> None:
    (job,) = yaml.safe_load((DOCKER / "prometheus.yaml").read_text())["scrape_configs"]
    (targets,) = job["static_configs"]
    assert targets["targets"] == [f"{name}:8000" for name in PLANNERS]

    provisioning = DOCKER / "grafana" / "provisioning"
    (source,) = yaml.safe_load((provisioning / "datasources" / "prometheus.yaml").read_text())[
        "datasources"
    ]
    assert source["url"] == "http://prometheus:9090"
    dashboard = (DOCKER / "grafana" / "anchorflow.json").read_text()
    assert set(re.findall(r'"uid": "(prom\w+)"', dashboard)) == {source["uid"]}


def test_the_volumes_of_compose_are_there() -> None:
    for service in COMPOSE["services"].values():
        for volume in service.get("volumes", []):
            source = volume.partition(":")[0]
            there = (DOCKER / source).exists() if source.startswith("./") else None
            assert there if there is not None else source in COMPOSE["volumes"], volume


def test_kserve_runs_the_image_by_its_protocol() -> None:
    options = parsed(CONTAINER["args"])
    predictor = INFERENCE["spec"]["predictor"]

    assert CONTAINER["image"] == COMPOSE["services"]["planner-1"]["image"]
    assert [port["containerPort"] for port in CONTAINER["ports"]] == [options["port"]]
    for probe in ("readinessProbe", "livenessProbe"):
        asked = CONTAINER[probe]["httpGet"]
        assert asked["port"] == options["port"]
        assert not scopes_for("GET", asked["path"])  # a probe has no token
    assert [str(path) for path in options["bundle"]] == ["/mnt/models"]
    assert CONTAINER["securityContext"]["readOnlyRootFilesystem"] is True
    assert predictor["model"]["runtime"] == RUNTIME["metadata"]["name"]
    formats = {each["name"] for each in RUNTIME["spec"]["supportedModelFormats"]}
    assert predictor["model"]["modelFormat"]["name"] in formats
    assert predictor["model"]["protocolVersion"] in RUNTIME["spec"]["protocolVersions"]
    assert predictor["terminationGracePeriodSeconds"] > options["notice_s"] + options["drain_s"]


def test_kubernetes_waits_for_a_first_start_and_for_the_drain() -> None:
    deployment, service = yaml.safe_load_all(
        (DOCKER / "kubernetes" / "anchorflow.yaml").read_text()
    )
    pod = deployment["spec"]["template"]
    (container,) = pod["spec"]["containers"]
    options = parsed(container["args"])
    (port,) = container["ports"]

    assert container["image"] == COMPOSE["services"]["planner-1"]["image"]
    assert port["containerPort"] == options["port"]
    for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
        asked = container[probe]["httpGet"]
        assert asked["port"] == port["name"]
        assert not scopes_for("GET", asked["path"])  # a probe has no token
    start = container["startupProbe"]
    assert start["periodSeconds"] * start["failureThreshold"] >= 3 * USUAL_S[STILL]
    assert pod["spec"]["terminationGracePeriodSeconds"] > options["notice_s"] + options["drain_s"]
    assert deployment["spec"]["selector"]["matchLabels"] == pod["metadata"]["labels"]
    assert service["spec"]["selector"] == pod["metadata"]["labels"]
    assert [each["targetPort"] for each in service["spec"]["ports"]] == [port["name"]]


@pytest.mark.parametrize("path", files(), ids=lambda path: path.relative_to(DOCKER).as_posix())
def test_no_file_names_a_registry(path: Path) -> None:
    """Sources of images and packages are settings of the build."""
    text = path.read_text()
    names = re.findall(r"(?:image:|FROM|BASE_IMAGE=|--from=)\s*(\S+)", text)

    for name in names:
        host, slash, _ = name.partition("/")
        assert host == "localhost" or not (slash and ("." in host or ":" in host)), name
    assert not re.search(r"(index-url|extra-index-url|trusted-host)", text)
