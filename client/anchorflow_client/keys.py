"""Zenoh's key expressions of the contract, in the one place where they are spelled.

anchorflow/v1/anchors/{model}                     anchors of a model, from any replica
anchorflow/v1/replica/{replica}                   the liveliness token of one replica
anchorflow/v1/replica/{replica}/anchors/{model}   anchors of a model, from this replica
anchorflow/v1/replica/{replica}/info              its cards and its load
"""

from __future__ import annotations

from anchorflow_client.contract.checks import describe
from anchorflow_client.errors import InvalidRequest

ROOT = "anchorflow/v1"
ALL_REPLICAS = f"{ROOT}/replica/*"
ALL_INFO = f"{ALL_REPLICAS}/info"

SPECIAL = "/*$?#"
"""What separates, globs or ends a key."""


def anchors_key(model: str) -> str:
    """Where any replica answers for a model. Raises `InvalidRequest`."""
    return f"{ROOT}/anchors/{_chunk(model, 'model')}"


def replica_key(replica: str) -> str:
    """The liveliness token of a replica. Raises `InvalidRequest`."""
    return f"{ROOT}/replica/{_chunk(replica, 'replica')}"


def replica_anchors_key(replica: str, model: str) -> str:
    """Where one replica answers for a model. Raises `InvalidRequest`."""
    return f"{replica_key(replica)}/anchors/{_chunk(model, 'model')}"


def info_key(replica: str) -> str:
    """Where a replica tells its cards and its load. Raises `InvalidRequest`."""
    return f"{replica_key(replica)}/info"


def replica_of(key: str) -> str:
    """The replica that a liveliness token names."""
    return key.removeprefix(f"{ROOT}/replica/").partition("/")[0]


def _chunk(name: str, field: str) -> str:
    """A name that may stand between two slashes of a key."""
    printable = name.isascii() and name.isprintable() and " " not in name
    if not name or not printable or set(name) & set(SPECIAL):
        what = f"a name without spaces and {' '.join(SPECIAL)}, to stand in a key"
        raise InvalidRequest(f"expected {what}, got {describe(name)}", field)
    return name
