"""How far a bundle's score hangs on the seed of its noise."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from statistics import mean

from anchorflow_benchmarks.driving.bundle_driver import SEED_MARK
from anchorflow_benchmarks.report import ResultTable, Row

NOTE = "Mean, least and most of the seeds; what differs by less is chance."


def seeds_table(pdms: Mapping[str, Sequence[float]]) -> ResultTable | None:
    """The PDMS of each bundle that drove with several seeds; None where none did.

    pdms: of each window, by driver
    """
    of_seeds: dict[str, list[float]] = {}
    for name, windows in pdms.items():
        if windows:
            of_seeds.setdefault(re.sub(rf"{SEED_MARK}\d+$", "", name), []).append(mean(windows))
    rows: list[Row] = [
        {"driver": name, "seeds": len(of), "PDMS": mean(of), "least": min(of), "most": max(of)}
        for name, of in of_seeds.items()
        if len(of) > 1
    ]
    return ResultTable("PDMS by seed", rows, NOTE) if rows else None
