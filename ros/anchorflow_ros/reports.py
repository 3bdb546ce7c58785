"""The node's figures and faults as diagnostics: at every change, and once a second."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray

from anchorflow_ros.driver import Decision
from anchorflow_ros.outputs import diagnostics_of, header_of

PERIOD_S = 1.0
"""Between two reports, unless something has changed."""


class Reports:
    """Makes the reports of one node, and measures its loop."""

    def __init__(self, name: str) -> None:
        """Set the name under which statuses appear."""
        self.name = name
        self._parts: tuple[tuple[str, int], ...] | None = None
        self._reported_at = -PERIOD_S
        self._ticks: list[tuple[float, float]] = []

    def note(self, began: float, ended: float) -> None:
        """Note the s on a steady clock between which a tick ran."""
        self._ticks.append((began, 1e3 * (ended - began)))

    def has_changed(self, decision: Decision) -> bool:
        """Return whether the faults are others than at the last call."""
        parts = tuple((fault.part, fault.level) for fault in decision.faults)
        changed, self._parts = parts != self._parts, parts
        return changed

    def due(
        self,
        decision: Decision,
        counts: Mapping[str, int],
        *,
        now: float,
        steady: float,
        changed: bool,
    ) -> DiagnosticArray | None:
        """Return the report, or None if nothing has changed and the last one is young.

        Args:
            decision: of the present tick.
            counts: of requests, as `Planner` has them.
            now: s, for the stamp.
            steady: s on the clock of `note`.
            changed: the faults have changed.
        """
        if not changed and steady - self._reported_at < PERIOD_S:
            return None
        figures = self._of_loop(steady) | _of_plan(decision)
        figures |= {f"requests {name}": str(number) for name, number in counts.items()}
        self._reported_at, self._ticks = steady, []
        return diagnostics_of(decision.faults, figures, name=self.name, header=header_of(now, ""))

    def _of_loop(self, steady: float) -> dict[str, str]:
        if not self._ticks:
            return {}
        span = max(steady - self._ticks[0][0], 1e-9)
        lasted = [lasted for _, lasted in self._ticks]
        return {
            "rate Hz": f"{len(lasted) / span:.1f}",
            "tick p50 ms": f"{np.median(lasted):.1f}",
            "tick max ms": f"{max(lasted):.1f}",
        }


def _of_plan(decision: Decision) -> dict[str, str]:
    figures: dict[str, Any] = {"braking": decision.braking}
    if (plan := decision.plan) is not None:
        figures |= {"plan": plan.state.value, "plan age ms": f"{plan.age_ms:.0f}"}
        if plan.batch is not None:
            figures["service ms"] = f"{plan.batch.timing_ms.get('total', np.nan):.0f}"
            figures["anchors safe"] = np.count_nonzero(plan.batch.arrays.get("safe", ()))
    return {name: str(value) for name, value in figures.items()}
