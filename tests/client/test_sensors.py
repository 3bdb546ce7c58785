"""The inputs of driving planners, of what real sensors give."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from PIL import Image

from anchorflow_client.errors import InvalidRequest
from anchorflow_client.sensors import (
    ROUTE_POINTS,
    ROUTE_SPACING_M,
    ego_status,
    lidar_histogram,
    resize_image,
    resized,
    route_ahead,
    stitch_cameras,
)


def image(red: int, rows: int = 1080, columns: int = 1920) -> np.ndarray:
    pixels = np.zeros((rows, columns, 3), np.uint8)
    pixels[..., 0] = red
    return pixels


def test_three_cameras_are_cropped_and_put_side_by_side() -> None:
    left, front, right = image(10), image(20), image(30)
    left[:, :416] = left[:, -416:] = 255
    left[:28] = front[:28] = front[-28:] = 255

    stitched = stitch_cameras(left, front, right)

    assert stitched.shape == (3, 256, 1024)
    assert stitched.dtype == np.uint8
    assert np.unique(stitched[0, :, :272]).tolist() == [10]
    assert np.unique(stitched[0, :, 272:752]).tolist() == [20]
    assert np.unique(stitched[0, :, 752:]).tolist() == [30]
    assert not stitched[1:].any()


def test_a_quarter_of_the_size_needs_no_resizing() -> None:
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 256, (270, 480, 3), np.uint8) for _ in range(3)]

    stitched = stitch_cameras(*images)

    np.testing.assert_array_equal(stitched[:, :, 272:752], images[1][7:-7].transpose(2, 0, 1))
    small = stitch_cameras(*images, rows=128, columns=512)
    halves = resize_image(stitched.transpose(1, 2, 0), rows=128, columns=512)
    np.testing.assert_array_equal(small, halves.transpose(2, 0, 1))


def test_resizing_averages_what_a_pixel_covers() -> None:
    pixels = np.arange(6 * 9 * 3, dtype=np.uint8).reshape(6, 9, 3)

    thirds = resize_image(pixels, rows=2, columns=3)
    uneven = resize_image(pixels[:, :3], rows=6, columns=2)

    np.testing.assert_array_equal(
        thirds, np.rint(pixels.reshape(2, 3, 3, 3, 3).mean((1, 3), dtype=np.float64))
    )
    first = (pixels[:, 0] * 2.0 + pixels[:, 1]) / 3
    np.testing.assert_array_equal(uneven[:, 0], np.rint(first))


def test_points_are_counted_in_their_cells() -> None:
    points = np.array(
        [
            [0.1, -31.9, 1.0],
            *([[31.99, 31.99, 0.3]] * 7),
            [0.1, -31.9, 0.2],  # too low
            [32.0, 0.0, 1.0],  # outside
            [1e30, 0.0, 1.0],
        ]
    )

    histogram = lidar_histogram(points)

    assert histogram.shape == (1, 256, 256)
    assert histogram.dtype == np.float32
    assert histogram[0, 128, 0] == pytest.approx(0.2)
    assert histogram[0, 255, 255] == 1.0
    assert np.count_nonzero(histogram) == 2


@pytest.mark.parametrize(
    ("wrong", "field"),
    [({"rows": 0}, "rows"), ({"rows": -1}, "rows"), ({"columns": 1024.0}, "columns")],
)
def test_a_wrong_size_is_named(wrong: dict[str, Any], field: str) -> None:
    quarter = image(0, 270, 480)
    size = {"rows": 256, "columns": 1024} | wrong
    came = re.escape(f"{field}: expected an integer from 1 to 16777216, got {size[field]}")

    with pytest.raises(InvalidRequest, match=came):
        stitch_cameras(quarter, quarter, quarter, **size)
    with pytest.raises(InvalidRequest, match=came):
        resize_image(np.zeros((256, 1024, 3), np.uint8), **size)


@pytest.mark.parametrize("numbers", [3, 6])
def test_a_cloud_of_columns_is_refused_with_what_turns_it(numbers: int) -> None:
    cloud = np.full((numbers, 100), 1.0)
    words = f"lidar: expected shape [P, 3], got [{numbers}, 100]; .T turns"
    with pytest.raises(InvalidRequest, match=re.escape(words)):
        lidar_histogram(cloud)

    assert lidar_histogram(cloud.T).sum() == 1.0
    assert lidar_histogram(cloud[:, :18]).sum() > 0  # more numbers a point than any sensor gives


def test_an_earlier_sweep_lies_where_it_is_now() -> None:
    # Two metres ahead of where the car was, which is 5 m behind, 1 m aside and turned left.
    histogram = lidar_histogram([[2.0, 0.0, 1.0]], pose=(-5.0, 1.1, np.pi / 2))

    row, column = np.argwhere(histogram[0])[0]
    assert (row, column) == ((32 - 5) * 4, round((32 + 3.0) * 4))


def test_ego_status() -> None:
    status = ego_status(command="right", velocity=(8.0, 0.5), acceleration=(-1.0, 0.0))

    np.testing.assert_array_equal(status, np.array([0, 0, 1, 0, 8, 0.5, -1, 0], np.float32))


def status_with(**changed: Any) -> np.ndarray:
    right: dict[str, Any] = {
        "command": "unknown",
        "velocity": (0.0, 0.0),
        "acceleration": (0.0, 0.0),
    }
    return ego_status(**right | changed)


MAKERS: dict[str, Callable[[Any], object]] = {
    "camera_left": lambda value: stitch_cameras(value, image(0), image(0)),
    "camera_front": lambda value: stitch_cameras(image(0), value, image(0)),
    "camera_right": lambda value: stitch_cameras(image(0), image(0), value),
    "image": lambda value: resize_image(value, rows=1, columns=1),
    "lidar": lidar_histogram,
    "pose": lambda value: lidar_histogram(np.zeros((1, 3)), pose=value),
    "command": lambda value: status_with(command=value),
    "velocity": lambda value: status_with(velocity=value),
    "acceleration": lambda value: status_with(acceleration=value),
}
NO_ARRAYS = ["abc", [[1.0, 2.0, 3.0], [1.0]], None, [1e300, 0.0], [{}, {}]]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("camera_left", image(0).astype(np.float32)),
        ("camera_front", image(0)[..., 0]),
        ("camera_right", image(0, rows=900)),
        *(("lidar", points) for points in (np.zeros((4, 2)), np.zeros(3), [[0.0, np.nan, 1.0]])),
        *(("pose", pose) for pose in ((0.0, 0.0), (0.0, np.nan, 0.0))),
        *(("command", each) for each in ("back", np.array(["left", "right"]), np.eye(4)[0])),
        ("velocity", (1.0, 2.0, 3.0)),
        ("acceleration", (0.0, np.inf)),
        *(
            (field, value)
            for field in ("lidar", "pose", "velocity", "acceleration", "image")
            for value in NO_ARRAYS
        ),
    ],
)
def test_a_wrong_input_is_named(field: str, value: Any) -> None:
    with pytest.raises(InvalidRequest) as told:
        MAKERS[field](value)

    assert told.value.field == field


def test_a_route_begins_beside_the_car_and_goes_on_straight() -> None:
    line = [[-30.0, 3.0], [10.0, 3.0], [10.0, 3.0], [10.0, 13.0]]  # one place twice
    route = route_ahead(line)
    assert route.shape == (ROUTE_POINTS, 2)
    assert route.dtype == np.float32
    np.testing.assert_allclose(route[0], [0.0, 3.0], atol=1e-6)
    np.testing.assert_allclose(route[5:8], [[10.0, 3.0], [10.0, 5.0], [10.0, 7.0]], atol=1e-5)
    np.testing.assert_allclose(route[-1], [10.0, 3.0 + ROUTE_SPACING_M * (ROUTE_POINTS - 6)])


def test_a_route_that_lies_ahead_begins_with_its_first_place() -> None:
    np.testing.assert_allclose(route_ahead([[5.0, 0.0], [9.0, 0.0]])[:2], [[5.0, 0.0], [7.0, 0.0]])


def test_where_a_route_crosses_itself_the_arm_that_leads_the_cars_way_counts() -> None:
    loop = [[-20.0, 0.5], [30.0, 0.5], [30.0, 30.0], [0.2, 30.0], [0.2, -60.0]]
    np.testing.assert_allclose(route_ahead(loop)[1], [2.0, 0.5], atol=1e-5)
    turned = [[-y, x] for x, y in loop]  # the car is on the other arm
    np.testing.assert_allclose(route_ahead(turned)[0], [0.0, 0.2], atol=1e-5)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[0.0, 0.0]], "route: expected two or more finite points [V, 2], got shape [1, 2]"),
        ([[0.0, 0.0], [0.0, np.nan]], "route: expected two or more finite points [V, 2], got some"),
        ([[1.0, 0.0], [1.0, 0.0]], "route: expected two or more points apart from each other"),
        (
            [[0.0, 0.0], [1e300, 0.0]],
            "expected numbers in [-1e+07, 1e+07] m, got 1e+300 at route[1][0]",
        ),
    ],
)
def test_what_is_no_route_is_refused(points: object, message: str) -> None:
    with pytest.raises(InvalidRequest, match=re.escape(message)):
        route_ahead(points)  # type: ignore[arg-type]


@pytest.mark.parametrize(("height", "width", "size"), [(120, 190, 64), (20, 33, 64), (64, 90, 64)])
def test_it_is_pillows_bicubic(height: int, width: int, size: int) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    wanted = np.asarray(
        Image.fromarray(pixels).resize((size, size), Image.Resampling.BICUBIC), dtype=int
    )

    got = resized(pixels.transpose(2, 0, 1), size).transpose(1, 2, 0)

    assert np.abs(got - wanted).max() <= 1  # Pillow rounds its weights
    assert (got != wanted).mean() < 0.01


def test_axes_before_are_kept_and_the_size_itself_is_free() -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (2, 3, 40, 30), dtype=np.uint8)
    both = resized(pixels, 24)
    assert (both.shape, both.dtype) == ((2, 3, 24, 24), np.uint8)
    np.testing.assert_array_equal(both[1], resized(pixels[1], 24))
    assert resized(both, 24) is both


PIXELS = np.zeros((3, 20, 30), np.uint8)
WRONG: dict[str, tuple[Any, Any, str]] = {
    "floats": (
        PIXELS / 255,
        16,
        "pixels: expected an array of uint8 [...,3,H,W], none of its sides 0, got an array of "
        "float64 and shape [3, 20, 30]",
    ),
    "floats of that size": (PIXELS[:, :16, :16] / 255, 16, "pixels: expected an array of uint8"),
    "colours last": (
        PIXELS.transpose(1, 2, 0),
        16,
        "shape [20, 30, 3]; np.moveaxis(pixels, -1, -3) puts the colours first",
    ),
    "colours last, of two": (np.zeros((2, 20, 30, 3), np.uint8), 16, "np.moveaxis(pixels, -1, -3)"),
    "grey": (PIXELS[0], 16, "pixels: expected an array of uint8 [...,3,H,W]"),
    "no rows": (PIXELS[:, :0], 16, "pixels: expected an array of uint8 [...,3,H,W]"),
    "no pictures": (PIXELS[None, ..., :0, :0], 16, "none of its sides 0, got an array of uint8"),
    "lists": (PIXELS.tolist(), 16, "pixels: expected an array of uint8 [...,3,H,W]"),
    "nothing": (PIXELS, 0, "size: expected an integer from 1 to 4096, got 0"),
    "less": (PIXELS, -1, "size: expected an integer from 1 to 4096, got -1"),
    "half a pixel": (PIXELS, 16.0, "size: expected an integer from 1 to 4096, got 16.0"),
    "more than a picture has": (PIXELS, 2**31, "size: expected an integer from 1 to 4096"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_no_picture_or_no_size_is_refused_by_name(case: str) -> None:
    pixels, size, message = WRONG[case]
    with pytest.raises(InvalidRequest, match=re.escape(message)):
        resized(pixels, size)
