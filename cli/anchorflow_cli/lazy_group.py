"""A group of commands, each imported when it is used: it may need packages that are missing."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any, NamedTuple

import typer
from typer.core import TyperGroup

from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import command_app


class LazyCommand(NamedTuple):
    """A command's function, MODULE:NAME in `package`, and the extra that its module needs."""

    place: str
    summary: str
    extra: str = "train"
    package: str = "anchorflow_cli"


def lazy_group(commands: Mapping[str, LazyCommand], *, who: str) -> type[TyperGroup]:
    """Return the group of these commands; who: how it is called, such as `anchorflow data`."""

    class Group(TyperGroup):
        def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002 typer's signature
            return list(commands)

        def resolve_command(self, ctx: Any, args: list[str]) -> Any:
            ctx.meta[who] = args  # whether help is asked for
            return super().resolve_command(ctx, args)

        def get_command(self, ctx: Any, cmd_name: str) -> Any:
            if (lazy := commands.get(cmd_name)) is None:
                return None
            module, name = lazy.place.split(":")
            called, arguments = f"{who} {cmd_name}", ctx.meta.get(who, ())
            with needs_extra(lazy.extra, who=called, summary=lazy.summary, arguments=arguments):
                function = getattr(import_module(f"{lazy.package}.{module}"), name)
            single = command_app()
            single.command(cmd_name)(function)
            return typer.main.get_command(single)

        def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
            with formatter.section("Commands"):
                formatter.write_dl([(name, each.summary) for name, each in commands.items()])

    return Group
