"""Replicas and routers of a zenoh network on this machine, in this process or in others."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import straight_lines
import trustme
from anyio.from_thread import start_blocking_portal

from anchorflow_benchmarks.programs import Program, router_command, running
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_service.planning import PlanningService
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

Serve = Callable[..., ZenohEndpoint]
Start = Callable[..., Program]


@pytest.fixture
def serve(planning: PlanningService) -> Iterator[Serve]:
    """Opens a service and joins it to the network of the settings."""
    with ExitStack() as stack:

        def start(
            settings: ZenohSettings, service: PlanningService = planning, **options: Any
        ) -> ZenohEndpoint:
            portal = stack.enter_context(start_blocking_portal())
            stack.enter_context(service)
            joined = ZenohEndpoint(service, open_session(settings), **options)
            return stack.enter_context(portal.wrap_async_context_manager(joined))

        yield start


@pytest.fixture
def replica(serve: Serve, endpoint: str) -> ZenohEndpoint:
    """Serve as replica "a", a peer that listens at `endpoint`."""
    return serve(ZenohSettings(listen=(endpoint,)), replica="a")


@pytest.fixture
def client(replica: ZenohEndpoint, endpoint: str) -> Iterator[ZenohAnchorClient]:
    """A client of that replica."""
    assert replica.replica == "a"
    with ZenohAnchorClient(endpoint, timeout_s=20) as client:
        yield client


@pytest.fixture
def start_router(endpoint: str) -> Iterator[Start]:
    """Starts a router at `endpoint` or `at` another one, by a config file if one is given."""
    with ExitStack() as stack:

        def start(*config_file: Path, at: str = endpoint) -> Program:
            router = Program("router", router_command(at, *config_file))
            return stack.enter_context(running(router))

        yield start


@pytest.fixture
def start_replica(endpoint: str) -> Iterator[Start]:
    """Starts a replica in a process of its own, which takes some seconds for an answer."""
    program = Path(straight_lines.__file__).with_name("slow_replica.py")
    with ExitStack() as stack:

        def start(name: str, seconds: float, *listen: str) -> Program:
            command = [sys.executable, str(program), endpoint, name, str(seconds), *listen]
            return stack.enter_context(running(Program(name, command)))

        yield start


class Authority:
    """Signs certificates in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._ca = folder, trustme.CA()
        self.certificate = folder / "ca.pem"
        self._ca.cert_pem.write_to_path(self.certificate)

    def sign(self, name: str, *, host: str = "127.0.0.1") -> tuple[Path, Path]:
        """Return a certificate and its key: `name`.pem and `name`.key."""
        signed = self._ca.issue_cert(host)
        certificate, key = self._folder / f"{name}.pem", self._folder / f"{name}.key"
        signed.cert_chain_pems[0].write_to_path(certificate)
        signed.private_key_pem.write_to_path(key)
        return certificate, key


@pytest.fixture
def authority(tmp_path: Path) -> Callable[..., Authority]:
    """Makes an authority in a folder, by default certificates/."""

    def make(folder: str = "certificates") -> Authority:
        (tmp_path / folder).mkdir()
        return Authority(tmp_path / folder)

    return make
