"""Judge predictions of the other road users on recorded logs, beside rules.

`anchorflow bench futures` prints a table of all, and of the moving ones by kind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from anchorflow_benchmarks import BenchmarkError, options
from anchorflow_benchmarks.planners import bundle_names
from anchorflow_benchmarks.report import ResultTable, Row, progress, report
from anchorflow_client.contract import ModelCard
from anchorflow_client.contract.batch import FUTURES
from anchorflow_driving.futures import (
    MISSED_M,
    MOVING_M,
    RULES,
    Futures,
    Predictor,
    asked_futures,
    judge_futures,
    recorded_futures,
)
from anchorflow_driving.log import CYCLIST, PEDESTRIAN, VEHICLE, DrivingLog, read_logs
from anchorflow_driving.sensors.inputs import draw_inputs
from anchorflow_driving.sensors.others import others_seen
from anchorflow_driving.window import PlannerView, Scenes
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.local import LocalClient

Array = NDArray[Any]

BASELINE = "constant_velocity"
FIGURES = ("minADE", "minFDE", "miss", "ADE")
KINDS = {"vehicles": VEHICLE, "people": PEDESTRIAN, "cyclists": CYCLIST}
NOTE = (
    "m, over the 8 poses of 4 s, of those whom the log shows for all of them; min: of the mode that"
    f" comes nearest, miss: share of others whose modes all end more than {MISSED_M:g} m away; ADE:"
    " of the likeliest mode; ratio: minADE by that of constant velocity; ms: median time of a"
    " prediction, for bundles of a whole plan."
)


def bundle_predictor(client: LocalClient, card: ModelCard) -> Predictor:
    """Return the predictor of a bundle. Raises `BenchmarkError` if its card has no futures."""
    if FUTURES not in {spec.name for spec in card.answer.extras}:
        raise BenchmarkError(f"{card.name}: expected the extra {FUTURES} on its card, got none")

    def predict(view: PlannerView, _: NDArray[np.float32]) -> Futures:
        return asked_futures(client, draw_inputs(view, card.inputs))

    return predict


def judge_predictors(
    predictors: Mapping[str, Predictor],
    logs: Iterable[DrivingLog],
    *,
    advance: Callable[[int], None] = lambda _: None,
) -> dict[str, dict[str, Array]]:
    """Return the figures [K] of each predictor over all road users in all windows, and ms."""
    rows: dict[str, list[dict[str, Array]]] = {name: [] for name in predictors}
    for log in logs:
        for window in Scenes(log):
            view, recorded = window.view, recorded_futures(window)
            others = others_seen(view)
            for name, predictor in predictors.items():
                started = perf_counter()
                futures = predictor(view, others)
                ms = 1e3 * (perf_counter() - started)
                figures = judge_futures(futures, recorded, others)
                rows[name].append({**figures, "ms": np.array([ms])})
            advance(1)
    return {
        name: {key: np.concatenate([each[key] for each in found]) for key in found[0]}
        for name, found in rows.items()
    }


def futures_tables(judged: Mapping[str, Mapping[str, Array]]) -> list[ResultTable]:
    """Return tables of all, of the moving ones, and of these by kind."""
    moves, kind = judged[BASELINE]["moves"], judged[BASELINE]["kind"]
    groups = {"Everybody": np.ones_like(moves), f"Moving {MOVING_M:g} m": moves}
    groups |= {f"Moving {name}": moves & (kind == 1 + each) for name, each in KINDS.items()}
    tables = []
    for title, chosen in groups.items():
        if not chosen.any():
            continue
        rows = [_row(name, judged, chosen) for name in judged]
        tables.append(ResultTable(f"{title} ({chosen.sum()})", rows, "" if tables else NOTE))
    return tables


def _row(name: str, judged: Mapping[str, Mapping[str, Array]], chosen: Array) -> Row:
    own = {figure: float(judged[name][figure][chosen].mean()) for figure in FIGURES}
    base = float(judged[BASELINE]["minADE"][chosen].mean())
    ms = float(np.median(judged[name]["ms"]))
    return {"predictor": name, **own, "ratio": own["minADE"] / base, "ms": ms}


def open_predictors(folders: Sequence[Path], *, threads: int | None) -> dict[str, Predictor]:
    """Return the rules, and the predictor of each bundle.

    Raises `BundleError` if a bundle is broken, `BenchmarkError` if it predicts nothing.
    """
    bundles = [load_bundle(folder) for folder in folders]
    found: dict[str, Predictor] = dict(RULES)
    for bundle, name in zip(bundles, bundle_names(bundles), strict=True):
        client = LocalClient(Engine(bundle, threads=threads))
        found[name] = bundle_predictor(client, bundle.card)
    return found


def futures(
    *,
    logs: Annotated[Path, typer.Option(help="Folder of driving logs (*.npz).")],
    bundle: options.DrivingBundles = None,
    threads: options.Threads = None,
    out: options.Out = options.RESULTS,
) -> None:
    """Score predictions of the other road users, by rules and bundles, on recorded logs."""
    found = read_logs(logs)
    predictors = open_predictors(bundle or [], threads=threads)
    windows = sum(log.windows for log in found)
    with progress("predicting", windows) as advance:
        judged = judge_predictors(predictors, found, advance=advance)
    about = {"logs": f"{logs.name}: {len(found)} files, {windows} windows"}
    report("Futures", about, futures_tables(judged), out)
