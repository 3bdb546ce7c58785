"""The tree of errors that the page on clients draws is the code's."""

from __future__ import annotations

import re
from pathlib import Path

from anchorflow_client import AnchorFlowError, RequestError, TransportError

PAGE = Path(__file__).parents[2] / "docs" / "clients.md"
BRANCH = re.compile(r"^[│├└─ ]*[├└]─ (\w+)", re.MULTILINE)


def test_every_error_hangs_on_the_tree_in_its_place() -> None:
    kinds = (RequestError, TransportError)
    expected = [name for kind in kinds for name in (kind, *kind.__subclasses__())]

    drawn = BRANCH.findall(PAGE.read_text(encoding="utf-8"))

    assert drawn == [kind.__name__ for kind in expected]
    assert all(issubclass(kind, AnchorFlowError) for kind in expected)
