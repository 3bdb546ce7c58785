"""An error of a worker process reaches who waits for it: every kind of error can be pickled."""

from __future__ import annotations

import inspect
import pickle
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from anchorflow_client.errors import AnchorFlowError

ROOT = Path(__file__).resolve().parents[1]
ERROR_CLASS = re.compile(r"^class \w+\(\w*Error\):", re.MULTILINE)


def kinds(base: type[AnchorFlowError] = AnchorFlowError) -> Iterator[type[AnchorFlowError]]:
    """A class and all below it, of the packages."""
    if base.__module__.startswith("anchorflow_"):
        yield base
    for kind in base.__subclasses__():
        yield from kinds(kind)


def made(kind: type[AnchorFlowError]) -> AnchorFlowError:
    """One with a text in every argument that it takes."""
    if not inspect.isfunction(kind.__init__):  # it takes a message alone
        return kind("expected this, got that")
    signature = inspect.signature(kind)
    bound = signature.bind(**{name: f"the {name}" for name in signature.parameters})
    return kind(*bound.args, **bound.kwargs)


def test_every_error_is_the_same_in_another_process() -> None:
    for path in sorted(ROOT.glob("*/anchorflow_*/**/*.py")):
        if ERROR_CLASS.search(path.read_text(encoding="utf-8")):
            module = path.relative_to(ROOT).with_suffix("").parts[1:]
            import_module(".".join(module))
    found = set(kinds())
    assert {"LogError", "BundleError", "Overloaded", "TimeStepUnknown"} <= {
        kind.__name__ for kind in found
    }
    for kind in found:
        sent = made(kind)
        came = pickle.loads(pickle.dumps(sent))
        assert (type(came), str(came), vars(came)) == (kind, str(sent), vars(sent))
