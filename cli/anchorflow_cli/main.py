"""`anchorflow COMMAND`: imports the module of a command and runs its typer app.

Other modules are not imported, so `anchorflow serve` never loads torch and
`anchorflow --help` answers on a base install. A new command is a module with a typer `app` and a
line in `COMMANDS`; an app of several functions becomes a group (`anchorflow data make`).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version

from anchorflow_cli.extras import needs_extra
from anchorflow_client.errors import AnchorFlowError


@dataclass(frozen=True)
class Command:
    """The module of a command, and the extra that it needs."""

    module: str
    summary: str
    extra: str  # of pyproject.toml, without which the module does not import


COMMANDS = {
    "serve": Command("anchorflow_cli.serve", "Serve a bundle over HTTP.", extra="service"),
    "token": Command("anchorflow_cli.token", "Make a token for a service.", extra="service"),
    "plan": Command("anchorflow_cli.plan", "Plan on a ROS map and draw it.", extra="service"),
    "data": Command("anchorflow_cli.data", "Make a dataset to train on.", extra="train"),
    "train": Command("anchorflow_cli.train", "Train a planner on a dataset.", extra="train"),
    "average": Command(
        "anchorflow_cli.average", "Average the weights of checkpoints.", extra="train"
    ),
    "distill": Command("anchorflow_cli.distill", "Teach a student of few steps.", extra="train"),
    "generate": Command(
        "anchorflow_cli.generate", "Draw anchors from a checkpoint.", extra="train"
    ),
    "export": Command("anchorflow_cli.export", "Make a bundle of a checkpoint.", extra="train"),
    "bench": Command("anchorflow_cli.bench", "Measure quality, latency and load.", extra="bench"),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the console script; an `AnchorFlowError` becomes one line and exit status 1."""
    name, *rest = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    if name in COMMANDS:
        run(name, rest)
    elif name in ("-h", "--help"):
        sys.stdout.write(usage())
    elif name == "--version":
        sys.stdout.write(f"anchorflow {version('anchorflow')}\n")
    else:
        sys.stderr.write(f"anchorflow: there is no command {name!r}\n\n{usage()}")
        raise SystemExit(2)


def run(name: str, arguments: Sequence[str]) -> None:
    """Run one command of `COMMANDS`."""
    who = f"anchorflow {name}"
    with needs_extra(COMMANDS[name].extra, who=who):
        module = import_module(COMMANDS[name].module)
    try:
        module.app(list(arguments), prog_name=who)
    except AnchorFlowError as error:
        raise SystemExit(f"{who}: {error}") from error


def usage() -> str:
    """Return the list of commands."""
    lines = [f"  {name:<8} {command.summary}" for name, command in COMMANDS.items()]
    return "\n".join(
        [
            "Usage: anchorflow COMMAND [OPTIONS]",
            "",
            *lines,
            "",
            "`anchorflow COMMAND --help` lists a command's options.",
            "",
        ]
    )
