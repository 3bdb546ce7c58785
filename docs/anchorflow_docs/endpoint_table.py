"""The paths that a service answers, out of its own OpenAPI document."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from anchorflow_docs.markdown import code, table


def endpoint_table(openapi: Mapping[str, Any]) -> str:
    """Markdown of every method of every path: what it does, and with which statuses it answers."""
    return table(["", "what it does", "statuses"], _rows(openapi["paths"]))


def _rows(paths: Mapping[str, Any]) -> Iterator[list[str]]:
    for path, methods in paths.items():
        for method, operation in methods.items():
            does = operation.get("description", operation["summary"])
            statuses = sorted(operation["responses"], key=int)
            first_paragraph = does.partition("\n\n")[0]
            yield [code(f"{method.upper()} {path}"), first_paragraph, ", ".join(statuses)]
