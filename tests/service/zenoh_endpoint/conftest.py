"""Replicas and routers of a zenoh network on this machine, in this process or in others."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import straight_lines
from anyio.from_thread import start_blocking_portal

from anchorflow_benchmarks.programs import Program, router_command, running
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_service.planning import PlanningService
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

KEY = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")

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
    """Signs certificates for this machine in a folder, by the openssl command."""

    def __init__(self, folder: Path, name: str = "ca") -> None:
        self.folder = folder
        self.name = name
        extensions = ["basicConstraints=critical,CA:TRUE", "keyUsage=critical,keyCertSign"]
        added = [word for extension in extensions for word in ("-addext", extension)]
        key = folder / f"{name}.key"
        out = ("-keyout", key, "-out", self.certificate, "-subj", f"/CN={name}", "-days", "2")
        self._openssl("req", "-x509", *KEY, *added, *out)

    @property
    def certificate(self) -> Path:
        """The certificate to trust."""
        return self.folder / f"{self.name}.pem"

    def sign(self, name: str, *, host: str = "IP:127.0.0.1") -> tuple[Path, Path]:
        """Return a certificate and its key: `name`.pem and `name`.key."""
        request, extensions = self.folder / f"{name}.csr", self.folder / f"{name}.ext"
        extensions.write_text(f"subjectAltName={host}\nextendedKeyUsage=serverAuth,clientAuth\n")
        key = self.folder / f"{name}.key"
        self._openssl("req", *KEY, "-keyout", key, "-out", request, "-subj", f"/CN={name}")
        authority = ("-CA", self.certificate, "-CAkey", self.folder / f"{self.name}.key")
        signed = ("-out", self.folder / f"{name}.pem", "-extfile", extensions, "-days", "2")
        self._openssl("x509", "-req", "-in", request, *authority, "-CAcreateserial", *signed)
        return self.folder / f"{name}.pem", key

    def _openssl(self, *arguments: object) -> None:
        command = ["openssl", *map(str, arguments)]
        subprocess.run(command, check=True, capture_output=True)


@pytest.fixture
def authority(tmp_path: Path) -> Callable[..., Authority]:
    """Makes an authority in a folder, by default certificates/."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl, which makes the certificates, is not installed")

    def make(folder: str = "certificates") -> Authority:
        (tmp_path / folder).mkdir()
        return Authority(tmp_path / folder)

    return make
