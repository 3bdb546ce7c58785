"""Code that the oldest supported Python refuses at import, and type checkers accept."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_no_named_tuple_has_another_base() -> None:
    """`class A(NamedTuple, Generic[T])` needs Python 3.11."""
    sources = list(ROOT.glob("*/anchorflow_*/**/*.py"))
    assert len(sources) > 100
    wrong = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in sources
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef)
        and len(node.bases) > 1
        and "NamedTuple" in [ast.unparse(base).rpartition(".")[2] for base in node.bases]
    ]
    assert wrong == []
