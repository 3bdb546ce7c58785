"""Open bundles as drivers of a benchmark."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.planners import CARD, bundle_names, parse_sampler
from anchorflow_client.contract import OdeSpec
from anchorflow_driving.bundle_driver import BundleDriver
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.local import LocalClient


def open_drivers(
    folders: Sequence[Path], *, num: int, samplers: Sequence[str] = (CARD,), threads: int | None
) -> list[BundleDriver]:
    """Return a driver for each bundle and sampler, with names that a file name may hold.

    Raises:
        BundleError: a bundle is broken.
        SensorError: a planner cannot drive logs.
        BenchmarkError: a bundle has no such sampler.
    """
    bundles = [load_bundle(folder) for folder in folders]
    drivers = []
    for bundle, name in zip(bundles, bundle_names(bundles), strict=True):
        safe_name = re.sub(r"[^\w.-]+", "_", name).strip("_")
        client = LocalClient(Engine(bundle, threads=threads))
        for text in samplers:
            sampler = None
            if isinstance(bundle.card.sampler, OdeSpec):
                spec = parse_sampler(text, bundle.card)
                sampler = {"method": spec.method, "schedule": list(spec.schedule)}
            elif text != CARD:
                raise BenchmarkError(f"{bundle.card.name}: expected sampler {CARD}, got {text!r}")
            label = safe_name if text == CARD else f"{safe_name}_{text.replace(':', '_')}"
            drivers.append(BundleDriver(client, bundle.card, num=num, name=label, sampler=sampler))
    return drivers
