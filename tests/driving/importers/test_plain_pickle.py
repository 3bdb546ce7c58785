"""A log's pickle may hold plain data; no other global in it is called."""

from __future__ import annotations

import collections
import functools
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anchorflow_driving.errors import LogError
from anchorflow_driving.importers.plain_pickle import load_plain_pickle

RECONSTRUCT: Any = np.zeros(1).__reduce__()[0]


class Calls:
    """Is whatever a function returns where it is unpickled."""

    def __init__(self, function: Callable, *arguments: object, state: object = None) -> None:
        self.made = (function, arguments) if state is None else (function, arguments, state)

    def __reduce__(self) -> Any:
        return self.made


@pytest.mark.parametrize("protocol", range(2, pickle.HIGHEST_PROTOCOL + 1))
def test_plain_data_comes_out_as_it_went_in(tmp_path: Path, protocol: int) -> None:
    arrays = [
        np.arange(14.0).reshape(2, 7),
        np.asfortranarray(np.arange(6, dtype=np.int16).reshape(2, 3)),
        np.arange(24).reshape(2, 3, 4).transpose(1, 0, 2),
        np.arange(10.0)[::3],
        np.arange(5, dtype=">f4"),
        np.zeros((0, 7), np.float32),
        np.array(3.5),
        np.array(["a", "bcd"]),
        np.array(["a", "b"], object),
        np.array([True, False]),
    ]
    others = {
        "texts": ["a", None, b"bytes", 2**70],
        "set": {1, 2},
        "numbers": (np.float64(1.5), np.int64(-3), np.bool_(True), np.str_("x")),
    }
    file = tmp_path / "plain.pkl"
    file.write_bytes(pickle.dumps([arrays, others], protocol=protocol))

    read, rest = load_plain_pickle(file)

    assert rest == others
    assert len(read) == len(arrays)
    for one, other in zip(read, arrays, strict=True):
        array = np.asarray(one)
        assert array.dtype == other.dtype.newbyteorder("=")
        np.testing.assert_array_equal(array, other)


def test_a_program_in_a_pickle_is_named_and_not_run(tmp_path: Path) -> None:
    file, trace = tmp_path / "bad.pkl", tmp_path / "trace"
    body = pickle.dumps([Calls(os.system, f"echo run > {trace}")])
    file.write_bytes(body)

    with pytest.raises(LogError) as told:
        load_plain_pickle(file)

    assert f"found the global {os.system.__module__}.system" in str(told.value)
    assert str(file) in str(told.value)
    assert not trace.exists()
    pickle.loads(body)  # that the program would have run
    assert trace.exists()


@pytest.mark.parametrize(
    ("function", "arguments", "name"),
    [
        (eval, ("1",), "eval"),
        (getattr, ((), "__class__"), "getattr"),
        (bytearray, (10,), "bytearray"),
        (functools.partial, (print,), "functools.partial"),
        (collections.OrderedDict, (), "collections.OrderedDict"),
        (np.fromfile, ("/etc/hostname",), "fromfile"),
        (np.load, ("a.npy",), "load"),
        (np.zeros, (3,), "zeros"),
    ],
)
def test_every_other_global_is_named(
    tmp_path: Path, function: Callable, arguments: tuple, name: str
) -> None:
    file = tmp_path / "bad.pkl"
    file.write_bytes(pickle.dumps(Calls(function, *arguments), protocol=2))

    with pytest.raises(LogError, match=rf"found the global .*{name}"):
        load_plain_pickle(file)


OBJECTS, RECORDS = np.dtype("O"), np.dtype([("a", "f8"), ("b", "O")])


@pytest.mark.parametrize(
    ("state", "found"),
    [
        ((1, (1,), OBJECTS, False, b"\x41" * 8), "without a list"),  # bytes as pointers
        ((1, (1,), RECORDS, False, b"\x41" * 16), "'V16'"),
        ((1, (1,), np.dtype("M8[s]"), False, b"\x41" * 8), "'M8'"),
        ((1, (1000,), np.dtype("f8"), False, b"\x41" * 8), "cannot reshape"),
        ((1, (-1, 0), np.dtype("f8"), False, b""), ""),
        ((1, (1,), "f8", False, b"\x41" * 8), "the type of an array is str"),
    ],
)
def test_an_array_that_is_none_is_refused(tmp_path: Path, state: tuple, found: str) -> None:
    file = tmp_path / "bad.pkl"
    array = Calls(RECONSTRUCT, np.ndarray, (0,), b"b", state=state)
    file.write_bytes(pickle.dumps(array))

    with pytest.raises(LogError) as told:
        load_plain_pickle(file)

    assert told.value.field == "file"
    assert found in str(told.value)


@pytest.mark.parametrize("body", [b"", b"no pickle", pickle.dumps([1, 2, 3])[:-2]])
def test_what_is_no_pickle_is_named(tmp_path: Path, body: bytes) -> None:
    file = tmp_path / "bad.pkl"
    file.write_bytes(body)

    with pytest.raises(LogError, match=r"bad\.pkl: file: expected a pickle of plain data"):
        load_plain_pickle(file)
