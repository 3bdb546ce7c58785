"""A file of the runs that a contest has made, so that one that was cut off can go on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from anchorflow_benchmarks.closed_loop.drive import End, Run
from anchorflow_benchmarks.closed_loop.scoring import Result
from anchorflow_benchmarks.errors import BenchmarkError

RunKey = tuple[str, str, int]
"""Contender, world, seed."""


@dataclass(frozen=True)
class RunLog:
    """Lines of JSON, a run each, after one with the settings that all of them share."""

    path: Path
    settings: Mapping[str, str]

    def known(self) -> dict[RunKey, Result]:
        """The runs of the file, which is begun where there is none.

        Raises:
            BenchmarkError: it holds runs of other settings, or something else.
        """
        if not self.path.exists():
            self.path.write_text(json.dumps(dict(self.settings)) + "\n", encoding="utf-8")
        first, *lines = self.path.read_text(encoding="utf-8").splitlines()
        try:
            settings, results = json.loads(first), [_result(json.loads(line)) for line in lines]
        except (ValueError, KeyError, TypeError) as error:
            raise BenchmarkError(f"{self.path}: not a file of runs ({error})") from error
        if settings != dict(self.settings):
            raise BenchmarkError(
                f"{self.path}: expected runs of {dict(self.settings)}, got runs of {settings}"
            )
        return {(result.contender, result.world, result.seed): result for result in results}

    def add(self, result: Result) -> None:
        """Append a run."""
        fields = asdict(result)
        fields["run"]["end"] = result.run.end.value
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(fields) + "\n")


def _result(fields: dict) -> Result:
    run = Run(**fields["run"] | {"end": End(fields["run"]["end"])})
    return Result(**fields | {"run": run, "latencies_ms": tuple(fields["latencies_ms"])})
