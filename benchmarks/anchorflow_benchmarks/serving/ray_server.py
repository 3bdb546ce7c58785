"""A program: replicas of a bundle on Ray Serve, until SIGTERM.

python -m anchorflow_benchmarks.serving.ray_server BUNDLE REPLICAS
"""

from __future__ import annotations

import signal
import socket
import sys
import threading
from pathlib import Path

import ray  # pyright: ignore[reportMissingImports] - an extra that not every venv has
from ray import serve  # pyright: ignore[reportMissingImports]

from anchorflow_service.ray_app import RaySettings, app


def main(bundle: str, replicas: int) -> None:
    """Serve on a free port, and say where."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    ray.init(num_cpus=replicas, include_dashboard=False, log_to_driver=False)
    serve.start(http_options={"host": "127.0.0.1", "port": port})
    serve.run(app(RaySettings(bundle=Path(bundle), min_replicas=replicas, max_replicas=replicas)))
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())  # in the place of Ray's own handler
    print(f"replicas at http://127.0.0.1:{port}", flush=True)
    ended.wait()
    serve.shutdown()
    ray.shutdown()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
