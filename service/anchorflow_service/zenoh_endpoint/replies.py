"""Replies to a query; whoever asked may be gone by then."""

from __future__ import annotations

import json
import logging

import zenoh

from anchorflow_client.errors import RequestError

logger = logging.getLogger(__name__)


def reply(
    query: zenoh.Query, key: str, payload: bytes, attachment: bytes | None, encoding: str
) -> None:
    """The answer, under the key of the queryable that gives it."""
    try:
        query.reply(key, payload, encoding=encoding, attachment=attachment, express=True)
    except zenoh.ZError as error:
        logger.warning("a reply on %s could not be sent: %s", key, error)


def refuse(query: zenoh.Query, error: RequestError) -> None:
    """The contract's error JSON."""
    said = json.dumps(error.to_dict(), ensure_ascii=False, separators=(",", ":"))
    try:
        query.reply_err(said.encode(errors="replace"), encoding="application/json")
    except zenoh.ZError as failure:
        logger.warning("a refusal could not be sent: %s", failure)
