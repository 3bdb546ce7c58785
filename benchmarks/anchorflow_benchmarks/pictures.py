"""Draw worst and typical scenes, quality over time, and cost over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, ScalarFormatter

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.judge import JudgedPlan
from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_trajectory.drawing import draw_cells, draw_ends, draw_paths, hide_ticks, sheet

PANEL_INCHES = 2.9
COLUMNS = 4
GOOD, BAD = "#1f6fb4", "#d1495b"
COLOURS = 10  # of matplotlib's cycle; further rows get other markers
MARKS = (("o", "^"), ("s", "v"), ("D", "<"))  # for success and `any`


def draw_scene_sheet(plans: Sequence[JudgedPlan], path: Path, *, title: str) -> None:
    """Draw the worst and the typical scene of each family by share of successes.

    Successes are blue, failures red. Raises `BenchmarkError` if `path` cannot be written.
    """
    families = sorted({plan.scene.family for plan in plans})
    panels = [panel for family in families for panel in _telling(plans, family)]
    figure, axes = sheet(len(panels), columns=COLUMNS, inches=PANEL_INCHES, header=0.4)
    for place, (label, plan) in zip(axes, panels, strict=True):
        _draw_plan(place, plan, label)
    figure.suptitle(title, fontsize=9)
    _save(figure, path)


def draw_quality_over_time(rows: Sequence[Row], path: Path) -> None:
    """Draw success and `any` of each row over its median time in ms.

    Raises `BenchmarkError` if `path` cannot be written.
    """
    figure = Figure((9.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    for index, row in enumerate(rows):
        ms, success, solved = (float(row[key] or 0.0) for key in ("ms", "success", "any"))
        color = f"C{index % COLOURS}"
        mark, triangle = MARKS[index // COLOURS % len(MARKS)]
        axes.plot([ms, ms], [success, solved], color=color, linewidth=0.8)
        axes.plot(ms, success, mark, color=color, label=str(row["planner"]))
        axes.plot(ms, solved, triangle, color=color)
    axes.set(xscale="log", xlabel="median time of a request [ms]", ylim=(-0.02, 1.02))
    axes.set_ylabel("success, and any (triangles)")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    _save(figure, path)


def draw_cost_over_time(tables: Sequence[ResultTable], path: Path) -> None:
    """Draw the mean J of the successes over the median time in ms, a panel per style.

    Each point is a number of descents. Raises `BenchmarkError` if `path` cannot be written.
    """
    figure = Figure((PANEL_INCHES * len(tables), 3.4), layout="constrained")
    panels = figure.subplots(1, len(tables), squeeze=False)[0]
    for axes, table in zip(panels, tables, strict=True):
        sources = dict.fromkeys(str(row["source"]) for row in table.rows)
        for index, source in enumerate(sources):
            rows = [row for row in table.rows if row["source"] == source]
            ms, cost = ([float(row[key] or 0.0) for row in rows] for key in ("ms", "J"))
            axes.plot(ms, cost, "o-", color=f"C{index}", markersize=4, label=source)
            for row, place in zip(rows, zip(ms, cost, strict=True), strict=True):
                axes.annotate(
                    str(row["descents"]), place, (3, 3), textcoords="offset points", fontsize=6
                )
        axes.set(xscale="log", title=table.title, xlabel="ms of a request")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_locator(NullLocator())
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("mean J of the successes")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    _save(figure, path)


def _telling(plans: Sequence[JudgedPlan], family: str) -> list[tuple[str, JudgedPlan]]:
    """Return the worst and the median scene of a family with their labels."""
    numbered = [(i, plan) for i, plan in enumerate(plans) if plan.scene.family == family]
    ranked = sorted(numbered, key=lambda one: one[1].verdict.measures["success"])
    chosen = {"worst": ranked[0]}
    if len(ranked) > 1:
        chosen["typical"] = ranked[len(ranked) // 2]
    return [
        (f"{family}, {kind}: scene {i}, {plan.verdict.measures['success']:.0%}", plan)
        for kind, (i, plan) in chosen.items()
    ]


def _draw_plan(axes: Axes, plan: JudgedPlan, label: str) -> None:
    scene, good = plan.scene, plan.verdict.success
    draw_cells(axes, scene.occupied, resolution=scene.resolution, origin=scene.origin)
    for kept, colour in ((~good, BAD), (good, GOOD)):
        draw_paths(axes, plan.anchors.positions[kept], colour, linewidths=0.7, alpha=0.7)
    draw_ends(axes, scene.x_curr, scene.x_goal)
    hide_ticks(axes)
    axes.set_title(label, fontsize=7)


def _save(figure: Figure, path: Path) -> None:
    try:
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise BenchmarkError(f"{path}: {error}") from error
