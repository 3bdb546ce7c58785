"""`anchorflow bench COMMAND`: imports one benchmark module and runs its command."""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

import typer
from typer.core import TyperGroup

from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import command_app


class Benchmark(NamedTuple):
    """The function of a command, and the extra of pyproject.toml that its module needs."""

    module: str
    function: str
    summary: str
    extra: str = "bench"


BENCHMARKS = {
    "quality": Benchmark("quality", "quality", "Judge anchors of bundles and baselines on scenes."),
    "latency": Benchmark("latency", "latency", "Time a request in this process by stage."),
    "earns": Benchmark("network_ablation", "earns", "Compare bundles with a search for routes."),
    "soft-costs": Benchmark("soft_costs", "soft_costs", "Judge anchors on dear ground."),
    "crowds": Benchmark("crowds.contest", "crowds", "Drive a robot among people."),
    "load": Benchmark("load", "load", "Load a server with closed-loop clients."),
    "zenoh": Benchmark("transports", "zenoh", "Time HTTP and zenoh beside the engine."),
    "drive": Benchmark("driving.open_loop", "drive", "Score drivers on recorded logs."),
    "drive-closed-loop": Benchmark(
        "driving.closed_loop", "drive_closed_loop", "Drive in simulated traffic.", extra="driving"
    ),
    "pairs": Benchmark("driving.pairs", "pairs", "Judge V2X-VLM on pairs.", extra="train"),
    "closed-loop": Benchmark(
        "closed_loop.contest", "closed_loop", "Drive a robot past obstacles.", extra="robot"
    ),
}


class LazyGroup(TyperGroup):
    """Lists commands without importing them: each may need packages that are not installed."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002 typer's signature
        return list(BENCHMARKS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002 typer's signature
        if cmd_name not in BENCHMARKS:
            return None
        benchmark = BENCHMARKS[cmd_name]
        with needs_extra(benchmark.extra, who=f"anchorflow bench {cmd_name}"):
            module = import_module(f"anchorflow_benchmarks.{benchmark.module}")
        single = command_app()
        single.command(cmd_name)(getattr(module, benchmark.function))
        return typer.main.get_command(single)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002 typer's signature
        with formatter.section("Commands"):
            formatter.write_dl([(name, each.summary) for name, each in BENCHMARKS.items()])


app = command_app()


@app.callback(cls=LazyGroup, no_args_is_help=True)
def bench() -> None:
    """Measure the anchors' quality, the engine's latency, a server's load."""
