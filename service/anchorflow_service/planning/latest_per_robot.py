"""Latest wins: a robot that asks again has no use for the answer to its older question."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from anchorflow_client.errors import Superseded
from anchorflow_service.planning.job import Job


class LatestPerRobot:
    """The newest job of each robot, as long as it waits or is worked on.

    Used on the event loop alone.
    """

    def __init__(self) -> None:
        self._newest: dict[str, Job[Any]] = {}

    def __len__(self) -> int:
        """Robots that wait for an answer."""
        return len(self._newest)

    def standing(self, robot_id: str | None, job: Job[Any]) -> Job[Any] | None:
        """The robot's older job, whose place this one would take.

        Raises:
            Superseded: the job is the older one, read later because it was longer.
        """
        if robot_id is None:
            return None
        standing = self._newest.get(robot_id)
        if standing is not None and standing.arrival.is_after(job.arrival):
            raise _superseded(robot_id)
        return standing

    @contextmanager
    def registered(self, robot_id: str | None, job: Job[Any]) -> Iterator[None]:
        """Inside, the job stands for its robot; the older one that stood there is cancelled.

        Raises:
            Superseded: as `standing`.
        """
        if robot_id is None:
            yield
            return
        if (standing := self.standing(robot_id, job)) is not None:
            standing.cancel(_superseded(robot_id))
        self._newest[robot_id] = job
        try:
            yield
        finally:
            if self._newest.get(robot_id) is job:
                del self._newest[robot_id]


def _superseded(robot_id: str) -> Superseded:
    return Superseded(f"a newer request of robot_id {robot_id!r} took this one's place", "robot_id")
