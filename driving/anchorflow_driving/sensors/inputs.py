"""The inputs of a planner from a view, by their names on its card."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import TensorSpec
from anchorflow_client.sensors import ego_status, resize_image, route_ahead
from anchorflow_driving.errors import SensorError
from anchorflow_driving.log import COMMANDS
from anchorflow_driving.sensors.lidar import simulated_lidar, simulated_lidar_before
from anchorflow_driving.sensors.recorded_lidar import recorded_lidar, recorded_lidar_before
from anchorflow_driving.window import PlannerView

if TYPE_CHECKING:
    from anchorflow_driving.sensors.rendering import Renderer

Sensor = Callable[[PlannerView, TensorSpec], NDArray[Any]]


def _bev(view: PlannerView, _: TensorSpec) -> NDArray[np.uint8]:
    # Here, because it needs Pillow, which other inputs do without.
    from anchorflow_driving.sensors.bev import draw_bev

    return draw_bev(view)


def _others(view: PlannerView, _: TensorSpec) -> NDArray[np.float32]:
    # Here, as the raster, whose extent it has.
    from anchorflow_driving.sensors.others import others_seen

    return others_seen(view)


def _camera(view: PlannerView, spec: TensorSpec) -> NDArray[np.uint8]:
    """Stitch recorded pictures or, if there are none, simulated ones, in the card's size."""
    rows, columns = (int(size) for size in spec.shape[-2:])
    if view.sensors is not None:
        # Here, because it needs Pillow.
        from anchorflow_driving.sensors.recorded_camera import recorded_camera

        return recorded_camera(view.sensors, view.frame, rows=rows, columns=columns)
    # Here, because it needs the extra "driving", which other inputs do without.
    from anchorflow_driving.sensors.cameras import simulated_camera

    picture = simulated_camera(view, _renderer()).transpose(1, 2, 0)
    return resize_image(picture, rows=rows, columns=columns).transpose(2, 0, 1)


def _lidar(view: PlannerView, _: TensorSpec) -> NDArray[np.float32]:
    sensors = view.sensors
    return simulated_lidar(view) if sensors is None else recorded_lidar(view, sensors)


def _lidar_before(view: PlannerView, _: TensorSpec) -> NDArray[np.float32]:
    sensors = view.sensors
    return simulated_lidar_before(view) if sensors is None else recorded_lidar_before(view, sensors)


@cache
def _renderer() -> Renderer:
    """One a process: it holds a context of the graphics driver."""
    from anchorflow_driving.sensors.rendering import Renderer

    return Renderer()


SENSORS: Mapping[str, Sensor] = {
    "bev": _bev,
    "camera": _camera,
    "ego_status": lambda view, _: status_of(view),
    "lidar": _lidar,
    "lidar_before": _lidar_before,
    "others": _others,
    "route": lambda view, _: route_ahead(view.route.points),
    "vehicle_size": lambda view, _: view.vehicle.size.astype(np.float32),
}
"""The possible inputs of a bundle, by name; camera and LiDAR are simulated unless recorded."""


def check_inputs(specs: Iterable[TensorSpec], *, of: str) -> None:
    """Check that a view has all inputs on the card of bundle `of`.

    Raises `SensorError` if it lacks one.
    """
    for spec in specs:
        if spec.name not in SENSORS:
            known = ", ".join(SENSORS)
            raise SensorError(f"{of}: expected inputs among {known}, got {spec.name}")


def draw_inputs(view: PlannerView, specs: Iterable[TensorSpec]) -> dict[str, NDArray[Any]]:
    """The inputs of one scene, without the leading B, by their names.

    Raises `SensorError` if the card's shape differs from the sensor's.
    """
    inputs = {}
    for spec in specs:
        drawn = inputs[spec.name] = SENSORS[spec.name](view, spec)
        if not _fits(drawn.shape, spec):
            raise SensorError(
                f"{spec.name}: expected a sensor of {list(spec.shape[1:])}, got {list(drawn.shape)}"
            )
    return inputs


def _fits(shape: tuple[int, ...], spec: TensorSpec) -> bool:
    """Whether one scene's shape is what the card says; an axis with a name is of any length."""
    axes = spec.shape[1:]
    return len(axes) == len(shape) and all(
        isinstance(axis, str) or axis == size for axis, size in zip(axes, shape, strict=True)
    )


def status_of(view: PlannerView) -> NDArray[np.float32]:
    """The ego status [8] of a window; the rear axle moves along its heading."""
    state = view.state
    return ego_status(
        command=COMMANDS[view.command],
        velocity=(state.speed, 0.0),
        acceleration=(state.acceleration, state.speed**2 * state.curvature),
    )
