"""`anchorflow bench COMMAND`: imports one benchmark module and runs its command."""

from __future__ import annotations

from anchorflow_cli.lazy_group import LazyCommand, lazy_group
from anchorflow_cli.options import command_app


def benchmark(place: str, summary: str, extra: str = "bench") -> LazyCommand:
    """Return the command of a benchmark, MODULE:FUNCTION."""
    return LazyCommand(place, summary, extra, package="anchorflow_benchmarks")


BENCHMARKS = {
    "quality": benchmark("quality:quality", "Judge anchors of bundles and baselines on scenes."),
    "latency": benchmark("latency:latency", "Time a request in this process by stage."),
    "earns": benchmark("network_ablation:earns", "Compare bundles with a search for routes."),
    "soft-costs": benchmark("soft_costs:soft_costs", "Judge anchors on dear ground."),
    "bodies": benchmark("bodies:bodies", "Judge anchors of robots with a footprint and wheels."),
    "crowds": benchmark("crowds.contest:crowds", "Drive a robot among people."),
    "load": benchmark("load:load", "Load a server with closed-loop clients."),
    "zenoh": benchmark("transports:zenoh", "Time HTTP and zenoh beside the engine."),
    "drive": benchmark("driving.open_loop:drive", "Score drivers on recorded logs."),
    "drive-closed-loop": benchmark(
        "driving.closed_loop:drive_closed_loop", "Drive in simulated traffic.", "driving"
    ),
    "futures": benchmark("driving.futures:futures", "Score predictions of the others.", "driving"),
    "pairs": benchmark("driving.pairs:pairs", "Judge V2X-VLM on pairs.", "train"),
    "checkpoints": benchmark(
        "checkpoints:checkpoints", "Train on from bundles and export them again.", "train"
    ),
    "published": benchmark(
        "published:published", "Train published configurations a step and export them.", "train"
    ),
    "closed-loop": benchmark(
        "closed_loop.contest:closed_loop", "Drive a robot past obstacles.", "robot"
    ),
    "replay": benchmark("replay:replay", "Plan at every tick of recorded drives.", "bags"),
}

app = command_app()


@app.callback(cls=lazy_group(BENCHMARKS, who="anchorflow bench"), no_args_is_help=True)
def bench() -> None:
    """Measure the anchors' quality, the engine's latency, a server's load."""
