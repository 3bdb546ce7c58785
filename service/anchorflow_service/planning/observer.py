"""Who hears what becomes of every call, on whichever transport it came."""

from __future__ import annotations

from anchorflow_service.planning.call import Call

ANSWERED = "ok"
CANCELLED = "cancelled"
"""Outcomes beside the codes of the contract's errors."""


class Observer:
    """Hears nothing; a subclass does what it wants to hear.

    A method may be called from any thread, and must neither block nor fail.
    """

    def ended(self, call: Call, outcome: str) -> None:
        """A call ended: `ANSWERED`, `CANCELLED`, or refused or failed with an error's code.

        What is known of it stands in the call: `model_id` and `timing_ms` of an answer.
        """

    def batch_planned(self, requests: int) -> None:
        """So many requests went through an engine together."""
