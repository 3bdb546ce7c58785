"""When a `Planner` may ask again: not before its period is over, and later after failures."""

from __future__ import annotations

from anchorflow_client.errors import AnchorFlowError, InvalidRequest
from anchorflow_client.patience import at_least_told, doubling
from anchorflow_client.planner.config import PlannerConfig


class Pacing:
    """Times are those of the planner's clock, in s."""

    def __init__(self, config: PlannerConfig) -> None:
        self._config = config
        self._not_before = -float("inf")
        self.answered()

    def is_due(self, now: float) -> bool:
        """Whether a request may be sent now."""
        return now >= self._not_before

    def asked(self, at: float) -> None:
        """A request was sent for what was seen at that time."""
        self._not_before = at + 1e-3 * self._config.period_ms

    def answered(self) -> None:
        """The service is well: the next failure is the first."""
        config = self._config
        self._pauses_ms = doubling(config.first_retry_ms, config.longest_retry_ms)

    def failed(self, error: AnchorFlowError, now: float) -> None:
        """A request was not answered, for this reason."""
        if isinstance(error, InvalidRequest):
            return  # the service is well, and the next view of the world may be too
        wait_s = at_least_told(1e-3 * next(self._pauses_ms), error)
        self._not_before = max(self._not_before, now + wait_s)
