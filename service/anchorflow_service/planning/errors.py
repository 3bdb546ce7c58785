"""What is said of an unexpected exception, whichever transport says it."""

from __future__ import annotations

from anchorflow_client.errors import InternalError


def internal_error(request_id: str) -> InternalError:
    """Where to look, and nothing of what it was."""
    return InternalError(f"internal error; the log tells of request {request_id}")
