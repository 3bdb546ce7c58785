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
from typing import Any

from anchorflow_cli.extras import needs_extra
from anchorflow_client.errors import AnchorFlowError


@dataclass(frozen=True)
class Command:
    """Where a command's typer app is, `MODULE` or `MODULE:NAME`, and the extra that it needs."""

    place: str
    summary: str
    extra: str  # of pyproject.toml, without which the module does not import

    def app(self) -> Any:
        """Import the typer app."""
        module, _, name = self.place.partition(":")
        return getattr(import_module(f"anchorflow_cli.{module}"), name or "app")


COMMANDS = {
    "serve": Command("serve", "Serve a bundle over HTTP.", "service"),
    "token": Command("token", "Make a token for a service.", "service"),
    "plan": Command("plan", "Plan on a ROS map and draw it.", "service"),
    "replay": Command("replay", "Plan at every tick of a recorded ROS 2 bag.", "bags"),
    "data": Command("data", "Make a dataset to train on.", "train"),
    "train": Command("training:train_app", "Train a planner on a dataset.", "train"),
    "average": Command("training:average_app", "Average the weights of checkpoints.", "train"),
    "distill": Command("training:distill_app", "Teach a student of few steps.", "train"),
    "generate": Command("generate", "Draw anchors from a checkpoint.", "train"),
    "export": Command("export", "Make a bundle of a checkpoint.", "train"),
    "checkpoint": Command("checkpoint", "Make a checkpoint of a bundle.", "train"),
    "bench": Command("bench", "Measure quality, latency and load.", "bench"),
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
    command = COMMANDS[name]
    with needs_extra(command.extra, who=who, summary=command.summary, arguments=arguments):
        app = command.app()
    try:
        app(list(arguments), prog_name=who)
    except AnchorFlowError as error:
        raise SystemExit(f"{who}: {error}") from error


def usage() -> str:
    """Return the list of commands."""
    lines = "".join(f"  {name:<10} {command.summary}\n" for name, command in COMMANDS.items())
    return (
        f"Usage: anchorflow COMMAND [OPTIONS]\n\n{lines}\n"
        "`anchorflow COMMAND --help` lists a command's options.\n"
    )
