"""Measure anchors, planners and servers; `anchorflow bench` runs the commands in here."""

from __future__ import annotations

from anchorflow_client.errors import AnchorFlowError


class BenchmarkError(AnchorFlowError):
    """A benchmark cannot run on its input, or its contenders do not do the same work."""
