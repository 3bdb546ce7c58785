"""Bundles swapped while clients ask: does any request fail, and who answers?"""

from __future__ import annotations

import http.client
import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter
from urllib.parse import urlsplit

from anchorflow_benchmarks.clients import asking, over_http
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.programs import served
from anchorflow_benchmarks.report import ResultTable, tally
from anchorflow_benchmarks.serving.crowd import CrowdConfig
from anchorflow_client.contract import AnchorRequest

VERSIONS = ("swap.1", "swap.2")


def swap_table(
    bundle: Path,
    requests: Sequence[AnchorRequest],
    config: CrowdConfig,
    *,
    swaps: int,
    folder: Path,
    progress: Callable[[str], None] = lambda _: None,
) -> ResultTable:
    """Swap two versions of a bundle to and fro while the crowd asks.

    Raises:
        BenchmarkError: a swap was refused.
    """
    name, swapped = _two_versions(bundle, folder), 0
    with served("--repository", str(folder)) as server:
        connect = over_http(server.url)
        with asking(connect, requests, callers=config.clients, seconds=config.seconds) as outcomes:
            until = perf_counter() + config.seconds
            while swapped < swaps and perf_counter() < until:
                _load(server.url, name, VERSIONS[swapped % 2])
                swapped += 1
                progress(f"swap {swapped} of {swaps}")
    row = {
        "swaps": swapped,
        "clients": config.clients,
        "answers": len(outcomes.ms),
        "failed": outcomes.failed,
        "codes": tally(outcomes.errors),
        "p99 ms": outcomes.p99_ms,
        "answered by": tally({model.version: n for model, n in outcomes.models.items()}),
    }
    return ResultTable("Swaps", [row], f"while the clients ask for {config.seconds:g} s")


def _two_versions(bundle: Path, folder: Path) -> str:
    """Copies of the bundle under two versions; gives the model's name."""
    name = ""
    for version in VERSIONS:
        copy = Path(shutil.copytree(bundle, folder / version))
        file = copy / "manifest.json"
        manifest = json.loads(file.read_text()) | {"version": version}
        file.write_text(json.dumps(manifest))
        name = manifest["name"]
    return name


def _load(url: str, name: str, version: str) -> None:
    connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=120)
    body = json.dumps({"parameters": {"version": version}})
    connection.request("POST", f"/v2/repository/models/{name}/load", body)
    answer = connection.getresponse()
    said = answer.read().decode()
    connection.close()
    if answer.status != 200:
        raise BenchmarkError(f"{name} {version} was not taken: {said}")
