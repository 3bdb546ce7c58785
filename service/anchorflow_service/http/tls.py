"""TLS: the server's certificate, and the authority of its callers' where they need one."""

from __future__ import annotations

import ssl
from pathlib import Path

from anchorflow_client.errors import AnchorFlowError


class TlsError(AnchorFlowError):
    """A certificate, a key or an authority cannot be used."""


def tls_context(certificate: Path, key: Path, *, client_ca: Path | None = None) -> ssl.SSLContext:
    """TLS 1.2 or later, for a server.

    Args:
        certificate: PEM file of the server's certificate and what it is signed by.
        key: PEM file of its private key, not encrypted.
        client_ca: PEM file of authorities; callers must show a certificate signed by one of them.

    Raises:
        TlsError: naming the file that cannot be used.
    """
    for path in filter(None, (certificate, key, client_ca)):
        _check_readable(path)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        # An encrypted key would have OpenSSL ask for its password at the terminal.
        context.load_cert_chain(certificate, key, password=_no_password)
    except ssl.SSLError as error:
        reason = error.reason or "not PEM"
        raise TlsError(f"{certificate} with {key}: no certificate and its key: {reason}") from error
    if client_ca is not None:
        try:
            context.load_verify_locations(client_ca)
        except ssl.SSLError as error:
            raise TlsError(f"{client_ca}: no PEM certificate of an authority") from error
        context.verify_mode = ssl.CERT_REQUIRED
    return context


def _no_password() -> str:
    raise TlsError("the private key is encrypted; expected one that is not")


def _check_readable(path: Path) -> None:
    try:
        with path.open("rb"):
            pass
    except OSError as error:
        raise TlsError(f"{path}: cannot be read: {error.strerror}") from error
