"""The error tree as tables."""

from __future__ import annotations

from anchorflow_client.errors import RequestError, TransportError
from anchorflow_docs.dataclass_table import first_paragraph
from anchorflow_docs.markdown import code, table


def refusals() -> str:
    """What a service may answer, by code and HTTP status."""
    kinds = sorted(RequestError.__subclasses__(), key=lambda kind: kind.http_status)
    rows = [
        [code(kind.code), str(kind.http_status), code(kind.__name__), first_paragraph(kind)]
        for kind in kinds
    ]
    return table(["code", "HTTP status", "class", "when"], rows)


def failures() -> str:
    """What a client raises where no answer of the contract comes."""
    rows = [
        [code(kind.__name__), first_paragraph(kind)] for kind in TransportError.__subclasses__()
    ]
    return table(["class", "when"], rows)
