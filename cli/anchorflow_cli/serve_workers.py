"""`anchorflow serve --workers N`: what each worker runs, and who looks after them."""

from __future__ import annotations

import os
import signal
import socket
import sys
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from tempfile import TemporaryDirectory

from anchorflow_cli.serve_options import ServeOptionError
from anchorflow_cli.serving import ServeChoice, open_service, serving_line, tell
from anchorflow_cli.zenoh_options import ZenohChoice
from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.http.lifecycle import CANCELLING_S
from anchorflow_service.observability.logs import set_up_logging
from anchorflow_service.observability.metrics import SHARED_FOLDER
from anchorflow_service.workers.link import FAILED
from anchorflow_service.workers.supervisor import Supervisor
from anchorflow_service.workers.worker import WorkerServer

CLOSING_S = 5.0
"""For a worker to close what it has open, after the last request."""


def check_workers(zenoh: ZenohChoice | None) -> None:
    """Raises `ServeOptionError` where there can be one worker only."""
    if sys.platform == "win32":
        raise ServeOptionError("--workers: expected 1 on Windows")
    if zenoh is not None:
        raise ServeOptionError(
            "--workers: expected 1 with --zenoh, whose replicas are services of their own; "
            "start one for each"
        )


def serve_by_workers(choice: ServeChoice, listener: socket.socket, workers: int) -> None:
    """Serve on the socket until a signal comes, which then is raised again.

    Raises:
        WorkerError: a worker cannot start.
    """

    def say(models: str) -> None:
        tell(f"{serving_line(models, choice, listener)}, {workers} workers")

    leave_s = choice.draining.notice_s + choice.draining.drain_s + CANCELLING_S + CLOSING_S
    supervisor = Supervisor(partial(work, choice), listener, count=workers, leave_s=leave_s)
    with TemporaryDirectory(prefix="anchorflow-metrics-") as folder:
        # Workers inherit it before they load prometheus_client, which reads it then.
        os.environ[SHARED_FOLDER] = folder
        came = supervisor.run(say)
    with suppress(KeyboardInterrupt):
        signal.raise_signal(came)


def work(
    choice: ServeChoice, listener: socket.socket, link: Connection, models: tuple[str, ...]
) -> None:
    """What runs in a worker's process; ends it with status 1 where it cannot start."""
    set_up_logging(choice.log_format, choice.log_level)
    try:
        opened = open_service(choice, choice.token_file, one_of_several=True, models=models)
        server = WorkerServer(
            opened.app,
            opened.service,
            link=link,
            models=opened.models,
            limits=choice.connections,
            draining=choice.draining,
            tls=choice.tls.context(),
        )
        server.run(sockets=[listener])
    except AnchorFlowError as error:
        link.send_bytes(FAILED + str(error).encode())
        raise SystemExit(1) from error
