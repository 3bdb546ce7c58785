"""A program: two replicas on Ray, retrying clients that ask without a pause, one replica killed.

Prints a JSON line: answers, requests that failed, replicas that were alive before and after, and
the models that answered.
"""

from __future__ import annotations

import json
import socket
import sys
import threading
import time
from collections import Counter

import numpy as np
import ray  # pyright: ignore[reportMissingImports] - an extra that not every venv has
from ray import serve  # pyright: ignore[reportMissingImports]

from anchorflow_client import AnchorClient, AnchorFlowError, RetryingClient
from anchorflow_service.ray_app import RaySettings, app

CLIENTS = 3
BEFORE_S, AFTER_S = 3.0, 12.0
PATIENCE_S = 60.0


class Asking:
    """Clients that ask one request after the other."""

    def __init__(self, url: str) -> None:
        self.counts: Counter[str] = Counter()
        self.models: set[str] = set()
        self._url = url
        self._stop = threading.Event()
        self._threads = [threading.Thread(target=self._ask) for _ in range(CLIENTS)]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """Wait for the answers that are still out."""
        self._stop.set()
        for thread in self._threads:
            thread.join()

    def _ask(self) -> None:
        plain = AnchorClient(self._url, timeout_s=20)
        with RetryingClient(plain, patience_s=PATIENCE_S) as client:
            while not self._stop.is_set():
                self._one_request(client)

    def _one_request(self, client: RetryingClient) -> None:
        try:
            anchors = client.plan(
                cost_map=np.zeros((64, 64)),
                resolution=0.1,
                x_curr=[-2.0, 0, 0, 0, 0, 0],
                x_goal=[2.0, 0, 0, 0],
                num_samples=8,
            )
        except AnchorFlowError as error:
            self.counts[f"failed: {error!r}"] += 1
        else:
            self.counts["answered"] += 1
            self.models.add(f"{anchors.model.name} {anchors.model.version}")


def replicas() -> list[str]:
    """Names of the actors that are alive."""
    named = ray.util.list_named_actors(all_namespaces=True)
    return [each["name"] for each in named if each["name"].startswith("SERVE_REPLICA::")]


def main() -> None:
    """Serve, ask, kill, ask on, and tell."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    serve.start(http_options={"host": "127.0.0.1", "port": port})
    serve.run(app(RaySettings(min_replicas=2, max_replicas=2)))
    before = replicas()
    asking = Asking(f"http://127.0.0.1:{port}")
    time.sleep(BEFORE_S)
    ray.kill(ray.get_actor(before[0], namespace="serve"))
    time.sleep(AFTER_S)
    asking.stop()
    after = replicas()
    told = {
        "replicas": [len(before), len(after)],
        "killed": before[0] not in after,
        "counts": dict(asking.counts),
        "models": sorted(asking.models),
    }
    sys.stdout.write(f"\n{json.dumps(told)}\n")
    serve.shutdown()
    ray.shutdown()


if __name__ == "__main__":
    main()
