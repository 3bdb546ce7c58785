"""Logs: written and read alike, and every fault of one named."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anchorflow_driving.errors import LogError
from anchorflow_driving.log import LAYOUT, DrivingLog, read_log, read_logs, write_log
from anchorflow_driving.window import Scenes
from anchorflow_trajectory.car.course import SAME_POINT

Street = Callable[..., DrivingLog]


@pytest.fixture
def arrays(street: Street, tmp_path: Path) -> dict[str, Any]:
    """A log's arrays in its file."""
    write_log(street(), tmp_path / "sound.npz")
    with np.load(tmp_path / "sound.npz") as file:
        return {key: file[key] for key in file.files}


def test_a_log_is_read_as_it_was_written(street: Street, tmp_path: Path) -> None:
    log = street(speed=7.0)
    write_log(log, tmp_path / "street.npz")

    again = read_log(tmp_path / "street.npz")

    assert again.path == str(tmp_path / "street.npz")
    for field in LAYOUT:
        np.testing.assert_array_equal(
            getattr(again, field), np.float32(0.1) if field == "dt" else getattr(log, field)
        )


def test_tokens_of_frames_are_kept_if_there_are_any(street: Street, tmp_path: Path) -> None:
    tokens = np.array(["", *map(str, range(1, street().frames))])
    write_log(street(frame_token=tokens), tmp_path / "told.npz")
    write_log(street(), tmp_path / "street.npz")
    kept = read_log(tmp_path / "told.npz").frame_token
    assert kept is not None
    assert kept.tolist() == tokens.tolist()
    assert read_log(tmp_path / "street.npz").frame_token is None
    for wrong in (tokens[1:], np.arange(len(tokens))):
        with pytest.raises(LogError, match=r"frame_token: expected texts \[80\], found"):
            street(frame_token=wrong)


def test_polylines_are_told_apart(street: Street) -> None:
    log = street()

    assert [line.tolist() for line in log.polylines("centre")] == [
        [[-100, 0], [200, 0]],
        [[-100, 4], [200, 4]],
    ]
    assert log.polylines("crosswalk") == ()
    assert log.route(0).tolist() == [[-100, 0], [200, 0]]


def with_entry(index: Any, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(array: np.ndarray) -> np.ndarray:
        array = array.copy()
        array[index] = value
        return array

    return change


@pytest.mark.parametrize(
    ("field", "change", "message"),
    [
        ("track_state", lambda a: a.astype(np.float64), "expected float32, found float64"),
        ("track_state", lambda a: a[..., :4], "expected [K, F, 5] with K = 1, F = 80, found"),
        ("track_type", lambda a: a[:, None], "expected [K], found [1, 1]"),
        ("track_size", lambda a: np.concatenate([a, a]), "found [2, 2]"),
        ("track_size", lambda a: 0 * a, "expected lengths and widths above 0"),
        ("track_size", with_entry((0, 1), np.inf), "found 5.0 to inf"),
        ("track_type", with_entry(0, 4), "expected 0 to 3, found 4"),
        ("track_state", with_entry((0, 70, 2), np.nan), "in all five numbers or in none"),
        ("track_state", with_entry((0, 40), np.nan), "the ego of window 0"),
        ("track_state", with_entry((0, 40), np.inf), "found infinity"),
        ("dt", lambda _: np.float32(0.5), "expected 0.1 s, found 0.5"),
        ("dt", lambda _: np.float64(0.1), "expected float32 [], found float64 []"),
        ("name", lambda _: np.array([1]), "expected str [], found int64 [1]"),
        ("drivable_offsets", lambda a: a[:-1], "expected offsets from 0 to 4"),
        ("lane_offsets", with_entry(1, 8), "expected at least 3 points each, found 0"),
        ("lane_offsets", with_entry(1, 2), "expected at least 3 points each, found 2"),
        ("drivable_offsets", lambda _: np.array([0, 2, 4], np.int32), "at least 3 points each"),
        ("centre_offsets", with_entry(1, 1), "expected at least 2 points each, found 1"),
        ("lane_intersection", lambda a: a[:1], "with K = 1, F = 80, L = 2, found [1]"),
        ("lane_points", with_entry((0, 0), np.nan), "expected finite numbers"),
        ("line_points", with_entry((0, 1), 5334e3), "x and y within 10000 m of 0, for float32"),
        ("track_state", with_entry((0, 0, 0), -10001.0), "x and y within 10000 m of 0, for"),
        ("track_state", lambda a: a[:, :65], "at least 66 frames for a window, found 65"),
        ("window_speed_limit", with_entry(0, 0.0), "expected m/s above 0, or NaN"),
        ("window_speed_limit", with_entry(0, np.inf), "found inf to inf"),
        ("lane_edges", lambda _: np.array([[0, 2]], np.int32), "expected 0 to 1, found 2"),
        ("window_ego", with_entry(0, 1), "expected 0 to 0, found 1"),
        ("window_frame", with_entry(0, 19), "expected 20 to 34, found 19"),
        ("window_frame", with_entry(0, 35), "expected 20 to 34, found 35"),
        ("window_command", with_entry(0, 3), "expected 0 to 2, found 3"),
        ("route_points", lambda a: 0 * a, "expected a route of some length, found window 0"),
        ("route_points", lambda a: 5e-11 * a, "window 0: no step above 1e-06 m"),
        ("route_offsets", lambda a: a[:1], "found [1]"),
    ],
)
def test_a_wrong_field_is_named(
    arrays: dict[str, Any],
    tmp_path: Path,
    field: str,
    change: Callable[[np.ndarray], np.ndarray],
    message: str,
) -> None:
    path = tmp_path / "broken.npz"
    np.savez(path, **{**arrays, field: change(arrays[field])})

    with pytest.raises(LogError) as caught:
        read_log(path)

    assert str(caught.value).startswith(f"{path}: {field}: expected ")
    assert message in str(caught.value)


def test_a_crosswalk_of_two_points_is_refused(street: Street) -> None:
    with pytest.raises(LogError, match="crosswalk_offsets: expected at least 3 points each, found"):
        street(
            crosswalk_points=np.array([[10, -2], [10, 2]], np.float32),
            crosswalk_offsets=np.array([0, 2], np.int32),
        )


def test_the_shortest_route_that_a_log_takes_can_be_driven(street: Street) -> None:
    short = np.array([[0.0, 0.0], [1.1 * SAME_POINT, 0.0]], np.float32)
    window = Scenes(street(route_points=short, route_offsets=np.array([0, 2], np.int32)))[0]

    assert np.isfinite(window.view.route.heading).all()
    assert np.isfinite(window.route.poses(np.array([1.0]))).all()


@pytest.mark.parametrize("field", LAYOUT)
def test_a_missing_field_is_named(arrays: dict[str, Any], tmp_path: Path, field: str) -> None:
    path = tmp_path / "broken.npz"
    np.savez(path, **{key: value for key, value in arrays.items() if key != field})

    with pytest.raises(LogError, match=rf"broken\.npz: {field}: expected the field, found none"):
        read_log(path)


def test_a_pickle_is_refused(arrays: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "broken.npz"
    np.savez(path, **{**arrays, "name": np.array({"a": 1}, dtype=object)})

    with pytest.raises(LogError, match="name: expected str, found Object arrays cannot be loaded"):
        read_log(path)


@pytest.mark.parametrize("content", [b"", b"not a log", b"PK\x03\x04"])
def test_what_is_no_log_is_said(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "broken.npz"
    path.write_bytes(content)

    with pytest.raises(LogError, match=r"broken\.npz: file: expected an \.npz of arrays"):
        read_log(path)


def test_a_damaged_file_is_said(street: Street, tmp_path: Path) -> None:
    """Wherever its bytes were changed, a file is read or refused: never another error."""
    path = tmp_path / "broken.npz"
    write_log(street(), path)
    sound, rng = path.read_bytes(), np.random.default_rng(0)
    refused = 0
    for _ in range(400):
        body = bytearray(sound)
        for place in rng.integers(0, len(body), 3):
            body[place] ^= int(rng.integers(1, 256))
        path.write_bytes(bytes(body))
        try:
            read_log(path)
        except LogError:
            refused += 1

    assert refused > 200


def test_a_single_array_is_no_log(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(3))
    path = tmp_path / "broken.npz"
    path.write_bytes(buffer.getvalue())

    with pytest.raises(LogError, match=r"file: expected an \.npz of arrays"):
        read_log(path)


def test_a_folder_without_logs_is_said(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"folder: expected logs \(\*\.npz\), found none"):
        read_logs(tmp_path)


def test_the_public_logs_are_sound(shared_data: Callable[[str], Path]) -> None:
    logs = read_logs(shared_data("driving"))

    assert sum(log.windows for log in logs) == 445
