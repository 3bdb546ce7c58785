"""Trajectory files: what is in each format comes out, on disk it stays, and errors name things."""

import pickle
import subprocess
import sys
import textwrap
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import h5py
import numpy as np
import pytest
import torch

from anchorflow_training.data.file_formats import H5Array, HeldArray, MappedArray, open_arrays
from anchorflow_training.dataset import DatasetError

POSITIONS = np.random.default_rng(0).normal(size=(20, 5, 2)).astype(np.float32)
QUALITY = np.linspace(0, 1, 20)
ARRAYS = {"positions": POSITIONS, "quality": QUALITY, "dt": np.float64(0.1)}


def write_h5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["positions"], file["quality"] = POSITIONS, QUALITY
        file.attrs["dt"] = 0.1


def write_pt(path: Path) -> None:
    tensors = {name: torch.tensor(values) for name, values in ARRAYS.items()}
    torch.save(tensors | {"dt": 0.1}, path)


WRITERS: dict[str, Callable[[Path], object]] = {
    "stored.npz": lambda path: np.savez(path, **ARRAYS),
    "packed.npz": lambda path: np.savez_compressed(path, **ARRAYS),
    "file.h5": write_h5,
    "file.pt": write_pt,
    "file.pkl": lambda path: path.write_bytes(pickle.dumps(ARRAYS)),
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same_arrays(name: str, tmp_path: Path) -> None:
    WRITERS[name](tmp_path / name)
    arrays = open_arrays(tmp_path / name, allow_pickle=True)

    assert set(arrays) == set(ARRAYS)
    assert arrays["positions"].shape == (20, 5, 2)
    some = np.array([7, 3, 3, 19])
    np.testing.assert_array_equal(arrays["positions"].read(some), POSITIONS[some])
    np.testing.assert_array_equal(arrays["positions"].read(slice(4, 9)), POSITIONS[4:9])
    np.testing.assert_array_equal(arrays["quality"].read(some), QUALITY[some])
    assert float(arrays["dt"].read(())) == 0.1
    assert arrays["positions"].on_disk == (name not in ("file.pt", "file.pkl"))


def test_a_tensor_without_a_name_holds_positions(tmp_path: Path) -> None:
    torch.save(torch.tensor(POSITIONS).bfloat16().requires_grad_(), tmp_path / "p.pth")
    positions = open_arrays(tmp_path / "p.pth")["positions"]
    np.testing.assert_allclose(positions.read(slice(None)), POSITIONS, rtol=1e-2)


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_npy_file_holds_positions(order: Literal["C", "F"], tmp_path: Path) -> None:
    np.save(tmp_path / "p.npy", np.asarray(POSITIONS, order=order))
    arrays = open_arrays(tmp_path / "p.npy")
    np.testing.assert_array_equal(arrays["positions"].read(slice(2, 4)), POSITIONS[2:4])


def test_arrays_on_disk_travel_to_a_worker_as_names(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", positions=np.zeros((1000, 50, 2)))
    write_h5(tmp_path / "b.h5")
    for file, kind in (("a.npz", MappedArray), ("b.h5", H5Array)):
        array = open_arrays(tmp_path / file)["positions"]
        assert isinstance(array, kind)
        packed = pickle.dumps(array)
        assert len(packed) < 1000
        again = pickle.loads(packed)
        np.testing.assert_array_equal(again.read(slice(0, 3)), array.read(slice(0, 3)))


def test_what_was_unpacked_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    np.savez_compressed(tmp_path / "packed.npz", positions=POSITIONS)
    arrays = open_arrays(tmp_path / "packed.npz")
    copy = pickle.loads(pickle.dumps(arrays["positions"]))
    del copy
    assert len(list((tmp_path / "temporary").iterdir())) == 1
    del arrays
    assert list((tmp_path / "temporary").iterdir()) == []


def test_a_large_file_is_read_in_little_memory(tmp_path: Path) -> None:
    """Twice 262 MB of maps, in a process that may hold 130 MB more than at its start."""
    maps = (4_000, 4, 64, 64)
    small = {"positions": np.ones((maps[0], 8, 2), np.float32), "dt": 0.1}
    np.savez(tmp_path / "large.npz", **small, cost_maps=np.zeros(maps, np.float32))
    with h5py.File(tmp_path / "large.h5", "w") as file:
        for key, values in small.items():
            file[key] = values
        file.create_dataset("cost_maps", maps, np.float32)
    program = f"""
        import resource
        from pathlib import Path
        import h5py
        import numpy as np
        from anchorflow_training.data import TrajectoryDataset

        def size(name):
            status = Path("/proc/self/status").read_text()
            return int(status.split(name + ":")[1].split()[0]) * 1024

        spare, before = 130 << 20, size("VmRSS")
        limit = size("VmData") + spare
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
        for name in ("large.npz", "large.h5"):
            dataset = TrajectoryDataset(Path({str(tmp_path)!r}, name))
            assert dataset.read(np.array([0, 3_999]))["cost_maps"].shape == (2, 4, 64, 64)
            assert size("VmHWM") - before < spare, (name, size("VmHWM") - before)
    """
    answer = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        check=False,
        capture_output=True,
        text=True,
    )
    assert answer.returncode == 0, answer.stderr


def test_a_pickle_is_opened_only_when_asked(tmp_path: Path) -> None:
    path = tmp_path / "mine.pkl"
    path.write_bytes(pickle.dumps({"positions": POSITIONS}))
    with pytest.raises(DatasetError, match=r"mine\.pkl.*runs whatever code.*--allow-pickle"):
        open_arrays(path)
    array = open_arrays(path, allow_pickle=True)["positions"]
    assert isinstance(array, HeldArray)


class Bomb:
    def __reduce__(self) -> tuple[object, ...]:
        return exec, ("raise KeyError('boom')",)


def test_no_code_of_a_file_runs_unasked(tmp_path: Path) -> None:
    objects = np.array([Bomb()], dtype=object)
    np.savez(tmp_path / "objects.npz", positions=objects, allow_pickle=True)
    with pytest.raises(DatasetError, match=r"objects\.npz: positions\.npy.*Python objects"):
        open_arrays(tmp_path / "objects.npz")
    (tmp_path / "bomb.pkl").write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(DatasetError, match=r"bomb\.pkl.*explicit|bomb\.pkl.*--allow-pickle"):
        open_arrays(tmp_path / "bomb.pkl")
    with pytest.raises(DatasetError, match=r"bomb\.pkl: cannot be unpickled.*boom"):
        open_arrays(tmp_path / "bomb.pkl", allow_pickle=True)


def test_a_torch_file_runs_no_code(tmp_path: Path) -> None:
    torch.save({"positions": Bomb()}, tmp_path / "bomb.pt")
    with pytest.raises(DatasetError, match=r"bomb\.pt: expected a dict of tensors.*found \S+$"):
        open_arrays(tmp_path / "bomb.pt", allow_pickle=True)


def test_a_pickle_of_unequal_lengths_names_the_array(tmp_path: Path) -> None:
    path = tmp_path / "ragged.pkl"
    path.write_bytes(pickle.dumps({"positions": [np.zeros((3, 2)), np.zeros((4, 2))]}))
    with pytest.raises(DatasetError, match=r"ragged\.pkl: positions: not one array"):
        open_arrays(path, allow_pickle=True)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.csv", b"1,2", r"a\.csv: expected \.npz, \.npy, \.h5, \.pt or \.pkl, found \.csv"),
        ("a.npz", b"no zip", r"a\.npz: not an \.npz file"),
        ("a.npy", b"no array", r"a\.npy: not an array"),
        ("a.h5", b"no such thing", r"a\.h5"),
        ("a.pt", b"1,2", r"a\.pt: expected a dict of tensors .* another file or a broken one$"),
    ],
)
def test_a_broken_file_is_named(name: str, content: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DatasetError, match=said):
        open_arrays(tmp_path / name)


@pytest.mark.parametrize("name", ["plain.npy", "stored.npz", "packed.npz"])
def test_a_damaged_file_is_named_or_opens(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if name == "plain.npy":
        np.save(path, POSITIONS)
    else:
        WRITERS[name](path)
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    damaged = [whole[:end] for end in range(0, len(whole), 23)]
    for at in rng.integers(0, min(len(whole), 400), 400):
        changed = bytearray(whole)
        changed[at] = rng.integers(256)
        damaged.append(bytes(changed))
    refusals: list[str] = []
    for content in damaged:
        path.write_bytes(content)
        try:
            open_arrays(path)
        except DatasetError as error:
            refusals.append(str(error))
    assert len(refusals) > len(damaged) / 10
    assert all(name in refusal for refusal in refusals)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    for name in ("gone.npy", "gone.npz", "gone.h5", "gone.pt", "gone"):
        with pytest.raises(DatasetError, match=rf"{name}: there is no such file"):
            open_arrays(tmp_path / name)


def test_a_file_that_was_cut_off_is_named(tmp_path: Path) -> None:
    np.save(tmp_path / "p.npy", POSITIONS)
    whole = (tmp_path / "p.npy").read_bytes()
    (tmp_path / "p.npy").write_bytes(whole[:-8])
    with pytest.raises(DatasetError, match=r"p\.npy: cut off, float32 \[20, 5, 2\] needs 800"):
        open_arrays(tmp_path / "p.npy")
    with zipfile.ZipFile(tmp_path / "p.npz", "w") as archive:
        archive.writestr("positions.npy", b"not an array")
    with pytest.raises(DatasetError, match=r"p\.npz: positions\.npy: not an array"):
        open_arrays(tmp_path / "p.npz")
