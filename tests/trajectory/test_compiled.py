"""Machine code that is kept on disk is never that of another source."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from anchorflow_trajectory.compiled import HERE, code_folder, stamp
from anchorflow_trajectory.ode.integrate import drawn

CALLER = "@compiled\ndef caller():\n    return callee()\n"
CALLEE = "@compiled_part\ndef callee():\n    return {}\n"


def test_a_change_in_any_compiled_function_changes_the_stamp(tmp_path: Path) -> None:
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE.format(1))
    first = stamp(tmp_path)
    (tmp_path / "callee.py").write_text(CALLEE.format(2))
    assert stamp(tmp_path) != first
    (tmp_path / "callee.py").write_text(CALLEE.format(1))
    (tmp_path / "plain.py").write_text("def plain(): ...\n")
    assert stamp(tmp_path) == first


def test_machine_code_is_kept_under_the_stamp() -> None:
    dispatcher: Any = drawn
    assert f"loops-{stamp(HERE.parent)}" in Path(dispatcher.stats.cache_path).parts
    assert code_folder() in Path(dispatcher.stats.cache_path).parents
