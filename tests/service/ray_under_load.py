"""A program: two replicas on Ray, retrying clients that ask without a pause, one replica killed.

Prints a JSON line: answers, requests that failed, replicas that were alive before and after, and
how many models answered.
"""

from __future__ import annotations

import json
import sys
import time
from contextlib import ExitStack

import numpy as np
import ray  # pyright: ignore[reportMissingImports] - an extra that not every venv has
from ray import serve  # pyright: ignore[reportMissingImports]

from anchorflow_benchmarks.load import Ask, asking
from anchorflow_benchmarks.programs import free_port
from anchorflow_client.contract import AnchorRequest, CostMap
from anchorflow_client.http import AnchorClient
from anchorflow_client.retry import RetryingClient
from anchorflow_service.ray_app import RaySettings, app

CALLERS = 3
BEFORE_S, AFTER_S = 3.0, 12.0
PATIENCE_S = 60.0
REQUEST = AnchorRequest.build(
    cost_map=CostMap.build(np.zeros((1, 64, 64)), 0.1),
    x_curr=[-2.0, 0, 0, 0, 0, 0],
    x_goal=[2.0, 0, 0, 0],
    num_samples=8,
)


def replicas() -> list[str]:
    """Names of the actors that are alive."""
    named = ray.util.list_named_actors(all_namespaces=True)
    return [each["name"] for each in named if each["name"].startswith("SERVE_REPLICA::")]


def main() -> None:
    """Serve, send requests, kill a replica, and print the results."""
    port = free_port()
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    serve.start(http_options={"host": "127.0.0.1", "port": port})
    serve.run(app(RaySettings(min_replicas=2, max_replicas=2)))
    before = replicas()

    def connect(stack: ExitStack) -> Ask:
        client = AnchorClient(f"http://127.0.0.1:{port}", timeout_s=20.0)
        return stack.enter_context(RetryingClient(client, patience_s=PATIENCE_S)).plan_request

    with asking(connect, [REQUEST], callers=CALLERS, seconds=BEFORE_S + AFTER_S) as outcomes:
        time.sleep(BEFORE_S)
        ray.kill(ray.get_actor(before[0], namespace="serve"))
    after = replicas()
    told = {
        "replicas": [len(before), len(after)],
        "killed": before[0] not in after,
        "answers": len(outcomes.ms),
        "failed": dict(outcomes.errors),
        "models": len(outcomes.models),
    }
    sys.stdout.write(f"\n{json.dumps(told)}\n")
    serve.shutdown()
    ray.shutdown()


if __name__ == "__main__":
    main()
