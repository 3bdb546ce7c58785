"""What a benchmark says when it cannot measure."""

from __future__ import annotations

from anchorflow_client.errors import AnchorFlowError


class BenchmarkError(AnchorFlowError):
    """A benchmark cannot run on what it was given, or its contenders do not do the same work."""
