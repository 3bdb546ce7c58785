"""TLS over a real socket, with certificates made here."""

from __future__ import annotations

import asyncio
import http.client
import ssl
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import trustme
from fastapi import FastAPI

from anchorflow_client import AnchorBatch, AnchorClient, AsyncAnchorClient, ConnectionFailed
from anchorflow_service.http.lifecycle import TlsError, TlsFiles

Behind = Callable[[TlsFiles], int]


class Files(NamedTuple):
    """PEM files of one authority and of what it signed."""

    authority: trustme.CA
    ca: Path
    certificate: Path
    key: Path


@pytest.fixture
def files(tmp_path: Path) -> Files:
    authority = trustme.CA()
    signed = authority.issue_cert("localhost")
    paths = Files(authority, *(tmp_path / name for name in ("ca.pem", "cert.pem", "key.pem")))
    authority.cert_pem.write_to_path(paths.ca)
    for index, blob in enumerate(signed.cert_chain_pems):
        blob.write_to_path(paths.certificate, append=index > 0)
    signed.private_key_pem.write_to_path(paths.key)
    return paths


@pytest.fixture
def behind(app: FastAPI, serve: Callable[..., Any]) -> Behind:
    """Starts the application behind TLS; gives its port."""
    return lambda tls: serve(app, tls=tls).port


def status_of_health(port: int, context: ssl.SSLContext) -> int:
    connection = http.client.HTTPSConnection("localhost", port, timeout=20, context=context)
    try:
        connection.request("GET", "/v2/health/ready")
        return connection.getresponse().status
    finally:
        connection.close()


def test_a_caller_who_trusts_the_authority_is_served(files: Files, behind: Behind) -> None:
    port = behind(TlsFiles(files.certificate, files.key))
    trusting = ssl.create_default_context(cafile=str(files.ca))

    assert status_of_health(port, trusting) == 200
    with pytest.raises(ssl.SSLCertVerificationError):
        status_of_health(port, ssl.create_default_context())


def test_our_clients_trust_whom_the_system_trusts(
    files: Files, behind: Behind, monkeypatch: pytest.MonkeyPatch, fields: dict[str, Any]
) -> None:
    url = f"https://localhost:{behind(TlsFiles(files.certificate, files.key))}"

    async def ask() -> AnchorBatch:
        async with AsyncAnchorClient(url, timeout_s=20) as client:
            return await client.plan(**fields)

    with AnchorClient(url) as client, pytest.raises(ConnectionFailed, match="CERTIFICATE_VERIFY"):
        client.plan(**fields)
    with pytest.raises(ConnectionFailed, match="CERTIFICATE_VERIFY"):
        asyncio.run(ask())

    monkeypatch.setenv("SSL_CERT_FILE", str(files.ca))
    with AnchorClient(url, timeout_s=20) as client:
        anchors = client.plan(**fields)
    np.testing.assert_array_equal(asyncio.run(ask()).trajectories, anchors.trajectories)


def test_old_versions_of_tls_are_refused(files: Files) -> None:
    context = TlsFiles(files.certificate, files.key).context()

    assert context.minimum_version is ssl.TLSVersion.TLSv1_2


def test_callers_need_a_certificate_where_an_authority_is_given(
    files: Files, behind: Behind
) -> None:
    port = behind(TlsFiles(files.certificate, files.key, client_ca=files.ca))
    nobody = ssl.create_default_context(cafile=str(files.ca))
    somebody = ssl.create_default_context(cafile=str(files.ca))
    files.authority.issue_cert("robot@example.com").configure_cert(somebody)

    assert status_of_health(port, somebody) == 200
    with pytest.raises((ssl.SSLError, OSError)):
        status_of_health(port, nobody)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"certificate": "absent"}, r"absent\.pem: cannot be read: No such file"),
        ({"certificate": "nonsense"}, r"nonsense\.pem with .*key\.pem: no certificate"),
        ({"key": "stranger"}, r"stranger\.pem: no certificate and its key"),
        ({"client_ca": "nonsense"}, r"nonsense\.pem: no PEM certificate of an authority"),
        ({"key": None}, "TLS needs --tls-cert and --tls-key, both of them"),
    ],
)
def test_a_file_that_cannot_be_used_is_named(
    files: Files, tmp_path: Path, changes: dict[str, str | None], match: str
) -> None:
    (tmp_path / "nonsense.pem").write_text("nonsense")
    stranger = trustme.CA().issue_cert("localhost").private_key_pem
    stranger.write_to_path(tmp_path / "stranger.pem")
    paths = {name: each and tmp_path / f"{each}.pem" for name, each in changes.items()}

    with pytest.raises(TlsError, match=match):
        replace(TlsFiles(files.certificate, files.key), **paths).context()


def test_an_encrypted_key_is_refused_and_asks_nobody(files: Files, tmp_path: Path) -> None:
    from cryptography.hazmat.primitives import serialization as pem

    key = pem.load_pem_private_key(files.key.read_bytes(), None)
    encrypted = tmp_path / "encrypted.pem"
    encrypted.write_bytes(
        key.private_bytes(
            pem.Encoding.PEM, pem.PrivateFormat.PKCS8, pem.BestAvailableEncryption(b"secret")
        )
    )

    with pytest.raises(TlsError, match="the private key is encrypted"):
        TlsFiles(files.certificate, encrypted).context()
