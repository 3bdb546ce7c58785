"""Bundles swapped while clients ask: does any request fail, and who answers?"""

from __future__ import annotations

import http.client
import json
import shutil
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from urllib.parse import urlsplit

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.report import ResultTable
from anchorflow_benchmarks.serving.crowd import CrowdConfig, Seen, crowd
from anchorflow_benchmarks.serving.served import served
from anchorflow_benchmarks.turns import p99
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
    name = _two_versions(bundle, folder)
    with served("--repository", str(folder)) as server:
        seen: list[Seen] = []
        asking = threading.Thread(target=lambda: seen.append(crowd(server.url, requests, config)))
        asking.start()
        done = 0
        while done < swaps and asking.is_alive():
            _load(server.url, name, VERSIONS[done % 2])
            done += 1
            progress(f"swap {done} of {swaps}")
        asking.join()
    (all_seen,) = seen
    row = {
        "swaps": done,
        "clients": config.clients,
        "answers": len(all_seen.answered_ms),
        "failed": sum(all_seen.refused.values()),
        "codes": ", ".join(f"{code} {n}" for code, n in all_seen.refused.items()) or "none",
        "p99 ms": p99(all_seen.answered_ms),
        "answered by": ", ".join(f"{v} {n}" for v, n in sorted(all_seen.versions.items())),
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
