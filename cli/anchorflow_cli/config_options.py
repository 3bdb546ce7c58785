"""Command-line options for every leaf of a nested configuration: `--batch.scenes 8`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

import typer

from anchorflow_training.settings import Setting, choices, default_of, settings

KINDS = {int: "INTEGER", float: "NUMBER"}


def with_options(kinds: Sequence[type], short: Mapping[str, str]) -> Callable[[Callable], Callable]:
    """Gives a command, which takes `**given`, an option for each leaf of any of the dataclasses.

    `given` holds what the command line names, by dotted path; whether the one that is chosen has
    such a leaf, it says itself when it is built.
    short: further names of options, by path
    """
    leaves: dict[str, Setting] = {}
    for leaf in (leaf for kind in kinds for leaf in settings(kind)):
        name = leaf.path.replace(".", "__")
        leaves[name] = _shared(leaves[name], leaf) if name in leaves else leaf

    def decorate(command: Callable) -> Callable:
        def run(**values: Any) -> None:
            named = {n: v for n, v in values.items() if n not in leaves}
            given = {leaves[n].path: v for n, v in values.items() if n in leaves and v is not None}
            command(**named, **given)

        own = inspect.signature(command, eval_str=True).parameters.values()
        own = [each for each in own if each.kind is not inspect.Parameter.VAR_KEYWORD]
        added = [_parameter(name, leaf, short) for name, leaf in leaves.items()]
        run.__signature__ = inspect.Signature([*own, *added])  # type: ignore[attr-defined]
        run.__annotations__ = {each.name: each.annotation for each in [*own, *added]}
        run.__name__, run.__doc__ = command.__name__, command.__doc__
        return run

    return decorate


def option_name(path: str) -> str:
    """The option of a setting: "batch.scenes" is `--batch.scenes`."""
    return "--" + path.replace("_", "-")


def _shared(one: Setting, other: Setting) -> Setting:
    """The option of two leaves under one path: as far as they are not alike, text by default."""
    return Setting(
        one.path,
        one.hint if one.hint == other.hint else str,
        default_of(one) if default_of(one) == default_of(other) else "the planner's",
        one.about or other.about,
    )


def _parameter(name: str, leaf: Setting, short: Mapping[str, str]) -> inspect.Parameter:
    names = [option_name(leaf.path), *([short[leaf.path]] if leaf.path in short else [])]
    about = " ".join(filter(None, [leaf.about, f"[default: {default_of(leaf)}]"]))
    if leaf.hint is bool:
        group, dot, last = leaf.path.rpartition(".")
        declared = "/".join([names[0], option_name(f"{group}{dot}no-{last}")])
        annotation = Annotated[bool | None, typer.Option(declared, *names[1:], help=about)]
    else:
        words = choices(leaf.hint)
        metavar = "|".join(words) if words else KINDS.get(leaf.hint, "TEXT")
        # The configuration converts the text, with the same messages as for a file.
        annotation = Annotated[str | None, typer.Option(*names, metavar=metavar, help=about)]
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation
    )
