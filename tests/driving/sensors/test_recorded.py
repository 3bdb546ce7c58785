"""Recorded sensors of nuScenes and NAVSIM in a planner's frame, on recordings made here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_sensors import POST, colour
from PIL import Image

from anchorflow_client.contract import TensorSpec
from anchorflow_client.sensors import stitch_cameras
from anchorflow_driving.errors import LogError
from anchorflow_driving.log import DrivingLog, read_log, write_log
from anchorflow_driving.sensors.inputs import draw_inputs
from anchorflow_driving.sensors.pinhole import REFERENCE_CAMERAS
from anchorflow_driving.window import Scenes, Window

LAYOUTS = pytest.mark.parametrize("layout", ["nuscenes", "navsim"])
SPECS = [
    TensorSpec("camera", "uint8", ("B", 3, 128, 512)),
    TensorSpec("lidar", "float32", ("B", 1, 256, 256)),
    TensorSpec("lidar_before", "float32", ("B", 1, 256, 256)),
]


def recorded(
    layout: str,
    folder: Path,
    *,
    change: Callable[[dict[str, Any], Path], None] = lambda *_: None,
    **options: Any,
) -> DrivingLog:
    """The log of a recording, changed before it is written."""
    made_by = import_module(f"made_{layout}")
    made = made_by.recording()
    made_by.add_sensors(made["tables"] if layout == "nuscenes" else made, folder)
    change(made, folder)
    path = made_by.write(folder, made)
    if layout == "navsim":
        options["map_file"] = path.with_name("map.gpkg")
    importer = import_module(f"anchorflow_driving.importers.{layout}")
    log, _ = getattr(importer, f"import_{layout}")(path, sensors=folder, **options)
    return log


def cells(histogram: np.ndarray) -> np.ndarray:
    """The middles [n, 2] m of the cells that were struck."""
    return np.argwhere(histogram[0] > 0) / 4 - 32 + 0.125


def post(window: Window, frame: int) -> np.ndarray:
    """Where the post is in the frame of the rear axle now."""
    axle = window.vehicle.rear_axle
    ahead = {"nuscenes": 1.385, "navsim": 1.461}[window.log.source]
    return np.array([POST[0] - 8.0 * 0.1 * frame - ahead + axle, POST[1]])


@LAYOUTS
def test_a_planner_is_shown_what_was_recorded_where_it_was(tmp_path: Path, layout: str) -> None:
    write_log(recorded(layout, tmp_path), tmp_path / "log.npz")
    log = read_log(tmp_path / "log.npz")

    assert set(log.window_ego.tolist()) == {0}
    assert log.windows > 3
    sky = stitch_cameras(*(np.rint(colour(c.rays)).astype(np.uint8) for c in REFERENCE_CAMERAS))
    sky = sky.reshape(3, 128, 2, 512, 2).mean((2, 4))
    for window in Scenes(log):
        seen = draw_inputs(window.view, SPECS)
        # The recorded pictures show less above and below than the reference cameras.
        unlike = np.abs(seen["camera"].astype(float) - sky)[:, 16:-16]
        assert np.quantile(unlike, 0.98) < 4.0
        # Both sweeps show the post where it is now, and nothing of the street and the bonnet.
        place = post(window, window.frame)
        for name in ("lidar", "lidar_before"):
            struck = cells(seen[name])
            assert len(struck) == (np.abs(place) < 32.0).all(), name
            assert (np.abs(struck - place) <= 0.13).all(), name


def test_a_pixels_ray_is_what_projects_to_its_middle() -> None:
    for camera, yaw in zip(REFERENCE_CAMERAS, (55.0, 0.0, -55.0), strict=True):
        places = np.array(camera.place) + 0.02 * camera.rays.reshape(-1, 3)
        rows, columns = np.mgrid[: camera.rows, : camera.columns].reshape(2, -1) + 0.5
        pixels = camera.project(camera.seen(places))
        np.testing.assert_allclose(pixels, np.stack([columns, rows], -1), atol=1e-9)
        x, y, z = camera.rays.mean((0, 1))
        assert (np.rad2deg(np.arctan2(y, x)), z) == pytest.approx((yaw, 0.0))
        assert camera.rays[0, 0, 2] > 0


@LAYOUTS
def test_pictures_are_stitched_as_recorded_where_that_is_asked(tmp_path: Path, layout: str) -> None:
    log = recorded(layout, tmp_path, rectified=False)

    seen = draw_inputs(Scenes(log)[0].view, SPECS[:1])["camera"]

    assert log.sensors is not None
    names = log.sensors.camera_file[:, log.window_frame[0]]
    plain = [np.asarray(Image.open(tmp_path / name)) for name in names]
    np.testing.assert_array_equal(seen, stitch_cameras(*plain, rows=128, columns=512))


def unlink(pattern: str) -> Callable[..., None]:
    return lambda _, folder: sorted(folder.glob(pattern))[6].unlink()  # of 7 s


def calibration(index: int, key: str, value: Any) -> Callable[..., None]:
    return lambda made, _: made["tables"]["calibrated_sensor"][index].__setitem__(key, value)


def without(channel: str) -> Callable[..., None]:
    def change(made: dict[str, Any], _: Path) -> None:
        rows = made["tables"]["sample_data"]
        made["tables"]["sample_data"] = [row for row in rows if channel not in row["token"]]

    return change


def camera(key: str, value: Any) -> Callable[..., None]:
    return lambda made, _: made["frames"][5]["cams"]["CAM_F0"].__setitem__(key, value)


@pytest.mark.parametrize(
    ("layout", "change", "said"),
    [
        ("nuscenes", unlink("samples/CAM_FRONT/*"), r"CAM_FRONT/.*: camera front: .* 1 of \d+ f"),
        ("nuscenes", unlink("samples/LIDAR_TOP/*"), r"LIDAR_TOP/.*: LiDAR.*: expected its file"),
        ("nuscenes", calibration(1, "rotation", [2.0, 0, 0, 0]), r"rotation: expected a quater"),
        ("nuscenes", calibration(1, "camera_intrinsic", []), r"CAM_FRONT-now\].camera_intrinsic"),
        ("nuscenes", without("CAM_FRONT_LEFT"), "expected files of CAM_FRONT_LEFT, found none"),
        ("navsim", unlink("log/CAM_L0/*"), r"CAM_L0/.*: camera left: expected its file"),
        ("navsim", camera("cam_intrinsic", np.zeros((3, 3))), "expected focal lengths above 0"),
        ("navsim", camera("distortion", np.zeros(4)), r"CAM_F0.distortion: .*found float64 \[4\]"),
    ],
)
def test_what_a_recording_lacks_is_named_when_it_is_imported(
    tmp_path: Path, layout: str, change: Callable[..., None], said: str
) -> None:
    with pytest.raises(LogError, match=said):
        recorded(layout, tmp_path, change=change)


@pytest.mark.parametrize(
    ("changed", "field", "found"),
    [
        ({"sensor_lidar_pose": np.zeros((121, 2), np.float32)}, "sensor_lidar_pose", "[121, 2]"),
        ({"sensor_camera_lens": np.full((3, 121, 9), np.nan, np.float32)}, "camera_lens", "NaN"),
        ({"sensor_folder": np.array(3)}, "sensor_folder", "int64 []"),
        ({"sensor_lidar_file": None}, "sensor_folder", "sensor_lidar_file"),
        ({"window_ego": np.ones(6, np.int32)}, "window_ego", "1"),
    ],
)
def test_what_is_wrong_in_a_logs_file_is_named(
    tmp_path: Path, changed: dict[str, Any], field: str, found: str
) -> None:
    path = tmp_path / "log.npz"
    write_log(recorded("nuscenes", tmp_path), path)
    with np.load(path) as file:
        kept = {name: changed.get(name, file[name]) for name in file.files}
    np.savez(path, **{name: array for name, array in kept.items() if array is not None})

    with pytest.raises(LogError) as told:
        read_log(path)

    assert told.value.field.endswith(field)
    assert found in told.value.found


def test_a_frame_that_no_sensor_saw_is_named(tmp_path: Path) -> None:
    view = Scenes(recorded("nuscenes", tmp_path))[0].view

    for frame, spec, missing in ((22, SPECS[1], 22), (2, SPECS[2], -3)):
        with pytest.raises(LogError, match=f"LiDAR: expected a file near frame {missing}, found"):
            draw_inputs(replace(view, frame=frame), [spec])


def damage(pattern: str, content: bytes) -> Callable[..., None]:
    def change(_: dict[str, Any], folder: Path) -> None:
        for file in folder.glob(pattern):
            file.write_bytes(content)

    return change


@pytest.mark.parametrize(
    ("layout", "change", "said"),
    [
        ("nuscenes", damage("samples/CAM_FRONT/*", b"no jpeg"), "camera front: expected a picture"),
        ("nuscenes", damage("samples/LIDAR_TOP/*", bytes(21)), "expected points of 5 float32"),
        ("nuscenes", calibration(1, "rotation", [1.0, 0, 0, 0]), "looks about 0 degrees .* 0% of"),
        ("navsim", damage("log/Merged*/*", b"VERSION 0.7\n"), "header of a .pcd, found no line"),
        ("navsim", damage("log/Merged*/*", b"FIELDS x\nDATA ascii\n"), "found DATA ascii"),
    ],
)
def test_what_is_damaged_is_named_when_it_is_seen(
    tmp_path: Path, layout: str, change: Callable[..., None], said: str
) -> None:
    log = recorded(layout, tmp_path, change=change)

    with pytest.raises(LogError, match=said):
        draw_inputs(Scenes(log)[0].view, SPECS)
