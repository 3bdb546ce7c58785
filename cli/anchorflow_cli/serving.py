"""`anchorflow serve`: opens the chosen service, and runs it in one process or in several."""

from __future__ import annotations

import gc
import logging
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal

import typer
import uvicorn
from fastapi import FastAPI
from starlette.middleware import Middleware
from uvicorn.config import STARTUP_FAILURE
from uvicorn.supervisors import Multiprocess

from anchorflow_cli.extras import needs_extra
from anchorflow_cli.listening import is_loopback, listen, url_of
from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle, load_bundle
from anchorflow_service.bundle.providers import DEVICES
from anchorflow_service.engine import Engine, later_loops
from anchorflow_service.http import create_app
from anchorflow_service.http.connections import ConnectionLimits
from anchorflow_service.http.lifecycle import Draining, GracefulExit, TlsFiles, uvicorn_config
from anchorflow_service.http.starting import answering_not_ready
from anchorflow_service.http.tokens import TokenFile
from anchorflow_service.observability.logs import set_up_logging
from anchorflow_service.observability.metrics import SHARED_FOLDER, reserve_shared_files
from anchorflow_service.planning import PlanningService, ServiceLimits
from anchorflow_service.repository import BundleFolders, FixedRepository, Repository, open_all
from anchorflow_trajectory.threads import usable_cores

if TYPE_CHECKING:
    from anchorflow_cli.zenoh_options import ZenohChoice
    from anchorflow_service.observability.spans import Tracing
    from anchorflow_service.zenoh_endpoint import ZenohEndpoint

# Literals, because typer reads its choices from the annotation.
LogFormat = Literal["text", "json"]
LogLevel = Literal["debug", "info", "warning", "error"]
Provider = Literal["cpu", "cuda", "tensorrt", "openvino"]

ZENOH_WAIT_S = 5.0
"""Time for a router to appear when the service starts."""

logger = logging.getLogger(__name__)


class ServeOptionError(AnchorFlowError):
    """The options do not go together."""


class WorkerError(AnchorFlowError):
    """A worker cannot start."""


@dataclass(frozen=True)
class ServeChoice:
    """Options of a service; picklable, for worker processes."""

    bundles: list[Path] | None
    repository: Path | None
    provider: Provider
    tokens: Path | None
    tls: TlsFiles
    connections: ConnectionLimits
    limits: ServiceLimits
    draining: Draining
    traces: str | None
    log_format: LogFormat
    log_level: LogLevel
    workers: int = 1

    @property
    def folders(self) -> BundleFolders:
        """Return the folders of the models, by default the bundle that ships."""
        named = self.bundles or ([] if self.repository else [DEFAULT_BUNDLE])
        return BundleFolders(named, repository=self.repository)

    @property
    def token_file(self) -> TokenFile | None:
        """Read the tokens. Raises `TokenFileError` if they cannot be used."""
        return None if self.tokens is None else TokenFile(self.tokens)

    def with_shared_threads(self) -> ServeChoice:
        """Return the choice of one worker: the cores are shared out, unless threads are given."""
        threads = self.limits.threads or max(1, usable_cores() // self.workers)
        return replace(self, limits=replace(self.limits, threads=threads))


def serve_until_stopped(
    choice: ServeChoice, host: str, port: int, *, zenoh: ZenohChoice | None
) -> None:
    """Listen, open the service and answer until a signal arrives.

    Raises `AnchorFlowError` if the service cannot start.
    """
    if choice.workers > 1:
        _check_workers(zenoh)
    if choice.tls:
        choice.tls.context()
    token_file = choice.token_file
    with listen(host, port) as listener:
        if token_file is None and not is_loopback(listener):
            logger.warning("everybody who reaches this address may ask: there is no --tokens")
        if choice.workers > 1:
            _serve_with_workers(choice.with_shared_threads(), listener)
            return
        why = partial(later_loops.starting, time.monotonic())
        with answering_not_ready(listener, why, tls=choice.tls, connections=choice.connections):
            app = open_service(choice, partial(_announce, choice, listener), zenoh=zenoh)
        server = uvicorn.Server(uvicorn_config(app, draining=choice.draining, tls=choice.tls))
        with suppress(KeyboardInterrupt):  # uvicorn raises the signal again after it has shut down
            server.run(sockets=[listener])


def open_service(
    choice: ServeChoice,
    announce: Callable[[str], None],
    *,
    zenoh: ZenohChoice | None = None,
) -> FastAPI:
    """Load the bundles and return the application.

    announce: called with the models' names and versions once requests are answered

    Raises `AnchorFlowError` if a bundle cannot be served, or the zenoh network cannot be joined.
    """

    def open_engine(folder: Path) -> Engine:
        bundle = load_bundle(folder)
        if advice := eight_bits_on_a_device(bundle, choice.provider):
            logger.warning(advice)
        return Engine(bundle, threads=choice.limits.threads, provider=choice.provider)

    folders = choice.folders
    later_loops.defer()
    engines = open_all(folders, open_engine)
    service = PlanningService(engines, default=next(iter(engines)), limits=choice.limits)
    endpoints: list[AbstractAsyncContextManager[object]] = [GracefulExit(service, choice.draining)]
    middleware = []
    if choice.traces is not None:
        tracing = _tracing(service, choice.traces)
        endpoints.append(tracing)
        middleware.append(Middleware(tracing.middleware))
    message = ", ".join(f"{each.card.name} {each.card.version}" for each in engines.values())
    if zenoh is not None:
        endpoint = _zenoh_endpoint(service, zenoh)
        endpoints.append(endpoint)
        replica = f"zenoh replica {endpoint.replica} ({zenoh.settings.describe()})"
        endpoints.append(_at_start(lambda: announce(message), lambda: print_line(replica)))
    else:
        endpoints.append(_at_start(lambda: announce(message)))
    endpoints.append(_at_start(later_loops.compile_later))
    if choice.workers > 1:
        reserve_shared_files()
    repository = FixedRepository if choice.workers > 1 else Repository
    app = create_app(
        service,
        connections=choice.connections,
        endpoints=endpoints,
        tokens=choice.token_file,
        repository=repository(service.engines, folders, open_engine),
        middleware=middleware,
    )
    # All of this lives as long as the process: the garbage collector need not visit it again.
    gc.collect()
    gc.freeze()
    return app


@asynccontextmanager
async def _at_start(*calls: Callable[[], None]) -> AsyncIterator[None]:
    for call in calls:
        call()
    yield


def print_line(line: str) -> None:
    """Print a line; if standard output cannot be written, log that instead."""
    try:
        typer.echo(line)
    except OSError as error:
        logger.warning("standard output cannot be written: %s", error.strerror)


def eight_bits_on_a_device(bundle: Bundle, provider: str) -> str | None:
    """Return what to do about a bundle in eight bits that is to run on a GPU, or None."""
    if provider not in DEVICES:
        return None
    if all(graph.precision == "float32" for graph in bundle.manifest.graphs.values()):
        return None
    return (
        f"{bundle.card.name} is in eight bits, which {provider} rounds otherwise than a CPU: its "
        "anchors differ by up to a metre; export its checkpoint with --float32 "
        f"--like {bundle.path} for a bundle to serve here"
    )


def _announce(choice: ServeChoice, listener: socket.socket, models: str) -> None:
    workers = f", {choice.workers} workers" if choice.workers > 1 else ""
    print_line(f"{models} at {url_of(listener, tls=bool(choice.tls))} ({choice.folders}){workers}")


def _tracing(service: PlanningService, url: str) -> Tracing:
    with needs_extra("otel", who="anchorflow serve --traces"):
        from anchorflow_service.observability.spans import tracing_to
    tracing = tracing_to(url)
    service.watch(tracing)
    return tracing


def _zenoh_endpoint(service: PlanningService, choice: ZenohChoice) -> ZenohEndpoint:
    """Join the network here, so that a failure is one line."""
    with needs_extra("zenoh", who="anchorflow serve --zenoh"):
        from anchorflow_client.zenoh_client.session import open_session
        from anchorflow_service.zenoh_endpoint import ZenohEndpoint
    session = open_session(choice.settings, wait_s=ZENOH_WAIT_S)
    return ZenohEndpoint(service, session, replica=choice.replica)


def _check_workers(zenoh: ZenohChoice | None) -> None:
    """Raise `ServeOptionError` if there can be only one worker."""
    if sys.platform == "win32":
        raise ServeOptionError("--workers: expected 1 on Windows")
    if zenoh is not None:
        raise ServeOptionError(
            "--workers: expected 1 with --zenoh, whose replicas are services of their own; "
            "start one for each"
        )


def _serve_with_workers(choice: ServeChoice, listener: socket.socket) -> None:
    """Run uvicorn's supervisor of processes. Raises `WorkerError` if a worker cannot start."""
    started = get_context("spawn").Value("i", 0)
    worker = partial(_worker_app, choice, listener, started)
    config = uvicorn_config(
        worker, factory=True, workers=choice.workers, draining=choice.draining, tls=choice.tls
    )
    with TemporaryDirectory(prefix="anchorflow-metrics-") as folder:
        # Workers inherit it; prometheus_client reads it when it is imported.
        os.environ[SHARED_FOLDER] = folder
        supervisor = Multiprocess(config, [listener])
        supervisor.run()
    if any(each.exitcode == STARTUP_FAILURE for each in supervisor.processes):
        raise WorkerError("a worker cannot start")


def _worker_app(choice: ServeChoice, listener: socket.socket, started: Any) -> FastAPI:
    """Return the application of a worker's process.

    started: number of workers that have started so far
    """
    set_up_logging(choice.log_format, choice.log_level)
    threading.Thread(target=_exit_with_supervisor, daemon=True).start()

    def count_start(models: str) -> None:
        with started.get_lock():
            started.value += 1
            is_last = started.value == choice.workers
        if is_last:
            _announce(choice, listener, models)

    try:
        return open_service(choice, count_start)
    except AnchorFlowError as error:
        logger.error("a worker cannot start: %s", error)
        # uvicorn stops all workers after a failure to start, and replaces one that exits otherwise.
        # It waits WORKER_HEALTHCHECK_S for an interpreter that shuts down, so end at once.
        os._exit(STARTUP_FAILURE if started.value < choice.workers else 1)


def _exit_with_supervisor() -> None:
    supervisor = parent_process()
    assert supervisor is not None
    wait([supervisor.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)
