"""Nothing that a service or a client reads may run code: no pickle, by its text or when it runs."""

from __future__ import annotations

import ast
import io
import json
import pickle
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    "client/anchorflow_client",
    "service/anchorflow_service",
    "trajectory/anchorflow_trajectory",
    "driving/anchorflow_driving",
)

# Opens pickles that its caller was asked to, and runs nothing in them:
# tests/driving/importers/test_plain_pickle.py.
PLAIN = {ROOT / "driving/anchorflow_driving/importers/plain_pickle.py"}

UNPICKLERS = {
    "pickle",
    "_pickle",
    "cPickle",
    "cloudpickle",
    "dill",
    "joblib",
    "jsonpickle",
    "marshal",
    "shelve",
    "torch",
}
UNSAFE_CALLS = {"eval", "exec", "compile", "__import__", "unsafe_load", "full_load"}


def sources() -> list[Path]:
    paths = {path for package in PACKAGES for path in (ROOT / package).rglob("*.py")}
    return sorted(paths - PLAIN)


def faults(source: str) -> Iterator[str]:
    """What in a text unpickles, or runs what it is given."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Import(names=names):
                yield from (each.name for each in names if each.name.split(".")[0] in UNPICKLERS)
            case ast.ImportFrom(module=str(module)) if module.split(".")[0] in UNPICKLERS:
                yield module
            case ast.Call(func=ast.Name(id=name)) if name in UNSAFE_CALLS:
                yield name
            case ast.Call(func=ast.Attribute(attr=name)) if name in UNSAFE_CALLS - {"compile"}:
                yield name
            case ast.keyword(arg="allow_pickle", value=ast.Constant(value=False)):
                pass
            case ast.keyword(arg="allow_pickle"):
                yield "allow_pickle"
            case ast.Call(func=ast.Attribute(value=ast.Name(id="yaml"), attr="load")):
                yield "yaml.load"


def test_no_module_that_reads_files_or_requests_unpickles() -> None:
    assert len(sources()) > 50
    assert {path: each for path in sources() if (each := list(faults(path.read_text())))} == {}


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("import pickle", ["pickle"]),
        ("def f():\n    from dill import loads", ["dill"]),
        ("import numpy as np\nnp.load(path, allow_pickle=True)", ["allow_pickle"]),
        ("np.load(path, allow_pickle=flag)", ["allow_pickle"]),
        ("yaml.load(text, Loader=yaml.Loader)", ["yaml.load"]),
        ("yaml.unsafe_load(text)", ["unsafe_load"]),
        ("eval(text)", ["eval"]),
        ("re.compile(text)", []),
        ("np.load(path, allow_pickle=False)", []),
        ("yaml.safe_load(text)", []),
    ],
)
def test_code_that_unpickles_is_found(source: str, found: list[str]) -> None:
    assert list(faults(source)) == found


# Answers with anything pickled in the place of JSON, tensors and manifests.
PROGRAM = """
import json, pickle, sys
from pathlib import Path

def forbidden(*args, **kwargs):
    raise SystemExit("something was unpickled")

import numpy, numpy.lib.format
pickle.load = pickle.loads = pickle.Unpickler = pickle._loads = forbidden

from anchorflow_client.codec import Payload
from anchorflow_client.errors import AnchorFlowError, InvalidAnswer, InvalidRequest
from anchorflow_client.codec import JsonCodec
from anchorflow_client.oip_codec import OipCodec
from anchorflow_service.bundle import BundleError, load_bundle
from anchorflow_service.http.orjson_codec import OrjsonCodec

body = Path(sys.argv[1]).read_bytes()
refused = []
for codec in (JsonCodec(), OrjsonCodec(), OipCodec()):
    for length in (None, len(body), 8):
        for decode in (codec.decode_request, codec.decode_answer):
            try:
                decode(Payload(body, length))
            except (InvalidRequest, InvalidAnswer):
                refused.append(type(codec).__name__)
try:
    load_bundle(Path(sys.argv[1]).parent)
except BundleError:
    refused.append("bundle")
print(json.dumps(refused))
"""


class Dangerous:
    """Runs a program where it is unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str, ...]]:
        return exit, ("unpickled",)


@pytest.mark.parametrize("form", ["pickle", "npy"])
def test_a_pickle_on_the_wire_is_refused_and_never_opened(tmp_path: Path, form: str) -> None:
    body = pickle.dumps(Dangerous())
    if form == "npy":
        buffer = io.BytesIO()
        np.save(buffer, np.array([Dangerous()], dtype=object), allow_pickle=True)
        body = buffer.getvalue()
    file = tmp_path / "manifest.json"
    file.write_bytes(body)

    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(file)], check=False, capture_output=True, text=True
    )

    assert run.returncode == 0, run.stdout + run.stderr
    assert len(json.loads(run.stdout)) == 3 * 3 * 2 + 1
