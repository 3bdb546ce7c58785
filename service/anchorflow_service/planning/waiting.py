"""The line of waiting jobs, and the batch that stands at its head."""

from __future__ import annotations

from typing import Any

from anchorflow_service.planning.job import Job

AnyJob = Job[Any]


class WaitingLine:
    """Jobs in the order in which they came; not safe to share between threads by itself."""

    def __init__(self) -> None:
        self._jobs: list[AnyJob] = []

    def count(self, *, but: AnyJob | None = None) -> int:
        """Jobs that still wait for something, `but` apart."""
        return sum(not job.has_ended and job is not but for job in self._jobs)

    @property
    def first(self) -> AnyJob | None:
        """The oldest, where there is one."""
        return self._jobs[0] if self._jobs else None

    def add(self, job: AnyJob) -> None:
        """At the end."""
        self._jobs.append(job)

    def discard(self, job: AnyJob) -> None:
        """Take it out, if it still stands in the line."""
        if job in self._jobs:
            self._jobs.remove(job)

    def batch(self, most: int) -> list[AnyJob]:
        """The oldest job and, up to `most` in all, those of its key that wait behind it.

        They stay in the line. Jobs that have ended leave it, and those whose budget is spent
        end here: no time goes into them.
        """
        self._jobs = [job for job in self._jobs if _still_counts(job)]
        if not self._jobs:
            return []
        first, *others = self._jobs
        alike = [other for other in others if first.key is not None and other.key == first.key]
        return [first, *alike[: most - 1]]

    def remove(self, batch: list[AnyJob]) -> None:
        """Take a batch out."""
        self._jobs = [job for job in self._jobs if job not in batch]

    def clear(self) -> list[AnyJob]:
        """Take out all."""
        jobs, self._jobs = self._jobs, []
        return jobs


def _still_counts(job: AnyJob) -> bool:
    if job.budget_ms is not None and not job.arrival.left_ms(job.budget_ms):
        job.expire()
    return not job.has_ended
