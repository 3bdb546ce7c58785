"""A file of the runs that a contest has made, so that one that was cut off can go on."""

from __future__ import annotations

import json
import os
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
        """The runs of the file, which is begun where there is none or an empty one.

        A last line that was cut off is taken out of the file.

        Raises:
            BenchmarkError: it holds runs of other settings, or something else, or it cannot be
                read or written.
        """
        settings = json.dumps(dict(self.settings)) + "\n"
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.path.touch()
            written = self.path.read_bytes()
            if settings.encode().startswith(written):
                self.path.write_text(settings, encoding="utf-8")
                return {}
            first, *lines, cut_off = written.split(b"\n")
            found, results = dict(json.loads(first)), [_result(json.loads(line)) for line in lines]
            for name in {**self.settings, **found}:
                wanted, got = self.settings.get(name), found.get(name)
                if wanted != got:
                    raise BenchmarkError(
                        f"{self.path}: {name}: expected runs of {wanted!r}, got runs of {got!r}; "
                        "another file begins anew"
                    )
            os.truncate(self.path, len(written) - len(cut_off))
        except OSError as error:
            raise BenchmarkError(f"{self.path}: {error.strerror}") from error
        except (ValueError, KeyError, TypeError) as error:
            raise BenchmarkError(f"{self.path}: not a file of runs ({error})") from error
        return {(result.contender, result.world, result.seed): result for result in results}

    def add(self, result: Result) -> None:
        """Append a run; raises `BenchmarkError` where that cannot be written."""
        fields = asdict(result)
        fields["run"]["end"] = result.run.end.value
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(fields) + "\n")
        except OSError as error:
            raise BenchmarkError(f"{self.path}: {error.strerror}") from error


def _result(fields: dict) -> Result:
    run = Run(**fields["run"] | {"end": End(fields["run"]["end"])})
    return Result(**fields | {"run": run, "latencies_ms": tuple(fields["latencies_ms"])})
