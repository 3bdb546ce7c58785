"""ROS maps: modes, thresholds, frames, windows and errors, on small maps written here."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from anchorflow_client import CostMap
from anchorflow_client.ros_map import (
    MARGIN_M,
    RosMap,
    RosMapError,
    WindowError,
    load_ros_map,
    map_window,
)

# Top row first, as a picture is: an occupied, an unknown, a free pixel over three free ones.
PIXELS = np.array([[0, 205, 254], [254, 254, 254]], dtype=np.uint8)
FIELDS = {
    "image": "map.pgm",
    "resolution": 0.5,
    "origin": [-1.0, 2.0, 0.0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}


@pytest.fixture
def write_map(tmp_path: Path) -> Callable[..., Path]:
    """Writes map.yaml and its picture. A field given as None is left out."""

    def write(pixels: np.ndarray[Any, Any] = PIXELS, **fields: Any) -> Path:
        fields = {k: v for k, v in (FIELDS | fields).items() if v is not None}
        Image.fromarray(pixels).save(tmp_path / str(fields.get("image", "map.pgm")))
        path = tmp_path / "map.yaml"
        path.write_text(yaml.safe_dump(fields))
        return path

    return write


def test_row_zero_is_the_bottom_and_unknown_is_occupied(write_map: Callable[..., Path]) -> None:
    ros_map = load_ros_map(write_map())

    assert_array_equal(ros_map.occupancy, [[0, 0, 0], [1, 1, 0]])
    assert_array_equal(ros_map.unknown, [[False] * 3, [False, True, False]])
    assert ros_map.occupancy.dtype == np.float32
    assert ros_map.resolution == 0.5
    assert_array_equal(ros_map.origin, [-1.0, 2.0])


ROWS: list[tuple[dict[str, Any], list[int], list[int]]] = [
    ({"negate": 1}, [0, 255], [0, 100]),
    (
        {"mode": "SCALE", "free_thresh": 0.2, "occupied_thresh": 0.6},
        [255, 204, 153, 102, 0],  # darkness 0, .2, .4, .6, 1
        [0, 0, 50, 100, 100],
    ),
    ({"mode": "rAW", "negate": 1}, [0, 25, 100, 101, 255], [0, 25, 100, -1, -1]),
    # Case M1: some savers write thresholds of 1 and 0, which belong to what they bound.
    ({"mode": "Trinary", "occupied_thresh": 1.0, "free_thresh": 0.0}, [0, 255, 205], [100, 0, -1]),
    ({"negate": 1, "occupied_thresh": 1.0, "free_thresh": 0.0}, [255, 0, 50], [100, 0, -1]),
]
"""A row of pixels and its values in percent; a mode may have any case (M7)."""


@pytest.mark.parametrize(("fields", "pixels", "values"), ROWS)
def test_pixels_are_read_by_mode_thresholds_and_negate(
    write_map: Callable[..., Path], fields: dict[str, Any], pixels: list[int], values: list[int]
) -> None:
    ros_map = load_ros_map(write_map(np.array([pixels], np.uint8), **fields))

    assert_array_equal(ros_map.values[:, :], [values])
    assert_array_equal(ros_map.unknown, [np.array(values) == -1])
    occupancy = [1.0 if value in (-1, 100) else value / 200 for value in values]
    assert_allclose(ros_map.occupancy, [occupancy], atol=1e-6)


def test_unknown_counts_as_free_on_request(write_map: Callable[..., Path]) -> None:
    ros_map = load_ros_map(write_map(), unknown_is_free=True)

    assert_array_equal(ros_map.occupancy, [[0, 0, 0], [1, 0, 0]])
    assert ros_map.unknown.sum() == 1


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_transparent_png_pixels_are_unknown(write_map: Callable[..., Path], mode: str) -> None:
    pixels = np.array([[[0, 0, 0, 255], [0, 0, 0, 0]]], dtype=np.uint8)
    ros_map = load_ros_map(write_map(pixels, image="map.png", mode=mode))

    assert_array_equal(ros_map.unknown, [[False, True]])


def test_a_plain_text_pgm_and_a_16_bit_png_read_the_same(write_map: Callable[..., Path]) -> None:
    expected = load_ros_map(write_map()).occupancy

    path = write_map(PIXELS.astype(np.uint16) * 257, image="map.png")
    assert_array_equal(load_ros_map(path).occupancy, expected)

    path = write_map()
    rows = "\n".join(" ".join(map(str, row)) for row in PIXELS)
    (path.parent / "map.pgm").write_text(f"P2\n# by hand\n3 2\n255\n{rows}\n")
    assert_array_equal(load_ros_map(path).occupancy, expected)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("image", None, "image: expected a file name, got None"),
        ("mode", "fuzzy", "mode: expected one of trinary, scale, raw, got 'fuzzy'"),
        ("resolution", 0, "resolution: expected a number from 1e-06 to 100, got 0"),
        ("resolution", "0.05 m", "resolution: expected a number from"),
        ("resolution", float("nan"), "resolution: expected a number from"),
        ("resolution", 1e308, "resolution: expected a number from"),
        ("resolution", 10**400, "resolution: expected a number from"),
        ("negate", 2, "negate: expected one of 0, 1, got 2"),
        ("free_thresh", 1.5, "free_thresh: expected a number from 0 to 1, got 1.5"),
        ("free_thresh", 0.7, "free_thresh: expected less than occupied_thresh, got 0.7"),
        ("occupied_thresh", None, "occupied_thresh: expected a number from 0 to 1, got None"),
        ("origin", [0, 0], "origin: expected three numbers x, y, yaw"),
        ("origin", [0, 0, 0.1], "origin: expected a yaw of 0"),
        ("origin", [0, -(10**400), 0], "origin: expected numbers in [-1e+07, 1e+07] m, got"),
        ("origin", [1e30, 0, 0], "origin: expected numbers in [-1e+07, 1e+07] m, got"),
    ],
)
def test_an_error_names_file_and_field(
    write_map: Callable[..., Path], field: str, value: object, message: str
) -> None:
    path = write_map(**{field: value})

    with pytest.raises(RosMapError) as caught:
        load_ros_map(path)
    assert str(caught.value).startswith(f"{path}: {message}")


def test_what_is_no_map_is_named(tmp_path: Path, write_map: Callable[..., Path]) -> None:
    with pytest.raises(RosMapError, match=r"absent\.yaml"):
        load_ros_map(tmp_path / "absent.yaml")

    path = write_map()
    (tmp_path / "map.pgm").write_text("not a picture")
    with pytest.raises(RosMapError, match=r"map\.pgm: image: expected a \.pgm or \.png picture"):
        load_ros_map(path)

    path.write_text("image: [map.pgm\n")
    with pytest.raises(RosMapError, match=r"map\.yaml: expected .* YAML file: while parsing .*$"):
        load_ros_map(path)

    path.write_text("- a list")
    with pytest.raises(RosMapError, match=r"map\.yaml: expected .* named fields"):
        load_ros_map(path)


@pytest.mark.parametrize(
    "content",
    [
        b"P5\n3 2",
        b"P5\nabc 2\n255\n" + PIXELS.tobytes(),
        b"P5\n3 2\n99999\n" + PIXELS.tobytes(),
        b"P5\n12345678901 2\n255\n" + PIXELS.tobytes(),
        b"P5\n50000 50000\n255\n" + PIXELS.tobytes(),
        b"P5\n3 2\n0\n" + PIXELS.tobytes(),
        b"P5\n3 2\n255\n" + PIXELS.tobytes()[:-1],
    ],
    ids=["cut off", "no number", "too bright", "too long", "too large", "no grey", "too short"],
)
def test_a_damaged_picture_is_named(write_map: Callable[..., Path], content: bytes) -> None:
    path = write_map()
    (path.parent / "map.pgm").write_bytes(content)
    with pytest.raises(RosMapError, match=r"map\.pgm: image: expected a \.pgm or \.png picture"):
        load_ros_map(path)


def checkerboard() -> RosMap:
    """6 × 8 cells of 0.5 m, its corner at (-1, 2)."""
    values = (100 * (np.indices((6, 8)).sum(axis=0) % 2)).astype(np.int8)
    return RosMap(values=values, resolution=0.5, origin=np.array([-1.0, 2.0]))


def test_a_window_inside_keeps_every_cell_in_its_place() -> None:
    window = checkerboard().crop(np.array([1.0, 3.5]), 2.0)

    assert_array_equal(window.occupancy, checkerboard().occupancy[1:5, 2:6])
    assert_allclose(window.origin, [0.0, 2.5])
    assert not window.unknown.any()


def test_a_window_reaches_into_the_unknown_beyond_the_map() -> None:
    window = checkerboard().crop(np.array([-1.0, 2.0]), 2.0)

    assert_allclose(window.origin, [-2.0, 1.0])
    assert_array_equal(window.unknown, [[True] * 4] * 2 + [[True, True, False, False]] * 2)
    assert_array_equal(window.occupancy[2:, 2:], checkerboard().occupancy[:2, :2])
    assert (window.occupancy[window.unknown] == 1).all()


def test_a_window_off_the_map_is_all_unknown() -> None:
    assert checkerboard().crop(np.array([40.0, -40.0]), 2.0).unknown.all()


@pytest.mark.parametrize("yaw", [-3.06e-17, 6.283185307179586, -6.283185307179586, 9e-10])
def test_a_yaw_that_is_rounding_is_0(write_map: Callable[..., Path], yaw: float) -> None:
    """Case M3."""
    assert load_ros_map(write_map(origin=[-10, -10, yaw])).origin.tolist() == [-10, -10]


@pytest.mark.parametrize("number", ["5e-2", '"0.05"', "+.05", "5.E-2", "0.05  # m"])
def test_numbers_are_read_as_yaml_cpp_reads_them(
    write_map: Callable[..., Path], number: str
) -> None:
    """Cases M4 and M6."""
    path = write_map()
    text = path.read_text().replace("resolution: 0.5", f"resolution: {number}")
    path.write_text(
        text.replace("- -1.0\n- 2.0", "- 1e+03\n- -50").replace("negate: 0", 'negate: "0"')
    )

    ros_map = load_ros_map(path)
    assert ros_map.resolution == 0.05
    assert ros_map.origin.tolist() == [1000.0, -50.0]


def test_what_is_between_the_thresholds_is_dear_and_no_obstacle(
    write_map: Callable[..., Path],
) -> None:
    """Case M12: grey of half the scale, of which 100 of 100 alone is an obstacle."""
    pixels = np.full((20, 20), 127, np.uint8)
    pixels[:5] = 0
    path = write_map(pixels, mode="scale", occupied_thresh=0.9, free_thresh=0.1)

    ros_map = load_ros_map(path)
    assert (ros_map.occupancy >= 0.5).sum() == 100
    assert_array_equal(ros_map.values[:15, :], 50)
    cost_map = CostMap.from_occupancy_grid(ros_map)
    assert cost_map.occupancy.sum() == 100
    assert_allclose(cost_map.data[2, 0], 0.5, atol=0.01)


@pytest.fixture(scope="module")
def large_map(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of 205 with one free row and one occupied column at (row 40, column 30)."""
    folder = tmp_path_factory.mktemp("large")
    pixels = np.full((6_499, 10_327, 2), [205, 255], np.uint8)
    pixels[-1 - 40] = [254, 255]
    pixels[:, 30] = [0, 255]
    Image.fromarray(pixels).save(folder / "large.png")
    path = folder / "map.yaml"
    path.write_text(
        yaml.safe_dump(FIELDS | {"image": "large.png", "resolution": 0.05, "origin": [0, 0, 0]})
    )
    return path


WINDOW_OF = """
import resource, sys
import numpy as np
from anchorflow_client.ros_map import load_ros_map, map_window
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
start, goal = np.array([1.0, 1.0]), np.array([2.0, 2.0])
seen = map_window(load_ros_map(sys.argv[1]), start, goal, size_m=20.0)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e6)
print((seen.values == 100).sum(), (seen.values == 0).sum(), (seen.values == -1).sum())
"""


def test_a_window_of_a_large_map_costs_little(large_map: Path) -> None:
    """Case M13: half a gigabyte of memory at most."""
    run = subprocess.run(
        [sys.executable, "-c", WINDOW_OF, str(large_map)],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    gigabytes, counts = run.stdout.splitlines()
    # The window reaches from -8.5 to 11.5 m; 170 rows and columns of it lie beyond the map.
    assert counts == f"230 229 {400 * 400 - 230 - 229}"
    assert float(gigabytes) < 0.5


def empty_map(*, resolution: float) -> RosMap:
    """60 × 60 m, its corner at the origin."""
    cells = round(60 / resolution)
    values = np.zeros((cells, cells), np.int8)
    return RosMap(values=values, resolution=resolution, origin=np.zeros(2))


def test_the_window_holds_both_ends_and_the_margin() -> None:
    start, goal = np.array([20.0, 30.0]), np.array([23.0, 34.0])
    window = map_window(empty_map(resolution=0.1), start, goal, size_m=None)

    side = window.occupancy.shape[0] * window.resolution
    assert window.occupancy.shape == (110, 110)
    for point in (start, goal):
        assert (point >= window.origin + MARGIN_M).all()
        assert (point <= window.origin + side - MARGIN_M).all()


def test_the_window_has_the_side_that_was_asked_for() -> None:
    window = map_window(empty_map(resolution=0.1), np.full(2, 30.0), np.full(2, 32.0), size_m=12.8)

    assert window.occupancy.shape == (128, 128)
    assert_allclose(window.origin, 31.0 - 6.4)


def test_the_window_has_the_cells_that_the_contract_wants_at_least() -> None:
    window = map_window(empty_map(resolution=1.0), np.full(2, 30.0), np.full(2, 31.0), size_m=2.0)

    assert window.occupancy.shape == (16, 16)


@pytest.mark.parametrize("size_m", [2.0, float("nan")])
def test_a_window_that_misses_the_ends_is_refused(size_m: float) -> None:
    with pytest.raises(WindowError, match="expected more than 2 m"):
        map_window(empty_map(resolution=0.1), np.full(2, 30.0), np.full(2, 32.0), size_m=size_m)


def test_a_window_with_too_many_cells_gets_wider_ones() -> None:
    start, goal = np.full(2, 5.0), np.full(2, 45.0)
    window = map_window(empty_map(resolution=0.05), start, goal, size_m=None)

    assert window.resolution == pytest.approx(0.15)
    assert window.occupancy.shape == (418, 418)  # of 62.6 m
    side = window.occupancy.shape[0] * window.resolution
    assert_allclose(window.origin + side / 2, [25.0, 25.0], atol=0.05)
    assert not window.occupancy[100:300, 100:300].any()


@pytest.mark.parametrize(
    ("unknown_occupancy", "dearest"),
    [(1.0, [[100, -1], [60, -1]]), (0.0, [[100, 60], [60, -1]])],
)
def test_wider_cells_are_the_dearest_of_those_they_cover(
    unknown_occupancy: float, dearest: list[list[int]]
) -> None:
    values = np.array([[100, -1, -1, 60], [0, 0, 0, 0], [60, 0, -1, -1], [0, 0, -1, -1]], np.int8)
    fine = RosMap(
        values=values,
        resolution=0.5,
        origin=np.array([-1.0, 2.0]),
        unknown_occupancy=unknown_occupancy,
    )
    coarse = fine.coarser(2)

    assert_array_equal(coarse.values[:, :], dearest)
    assert coarse.resolution == 1.0
    assert_allclose(coarse.origin, fine.origin)


def test_an_end_off_the_map_is_said_to_be_off_it() -> None:
    ends = np.array([70.0, 30.0]), np.array([58.0, 30.0])
    said = r"start: expected a place on the map \(x from 0 to 60 m .*\), got \(70, 30\) m"
    with pytest.raises(WindowError, match=said):
        map_window(empty_map(resolution=0.1), *ends)
    map_window(replace(empty_map(resolution=0.1), unknown_occupancy=0.0), *ends)
