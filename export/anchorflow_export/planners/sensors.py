"""What planners that see by camera and LiDAR are asked with."""

from __future__ import annotations

from anchorflow_client.contract import TensorSpec
from anchorflow_models.transfuser import STATUS, TransfuserConfig

F32 = "float32"
FASTEST = 60.0  # m/s, and m/s²: what a status may say


def sensor_inputs(backbone: TransfuserConfig) -> tuple[TensorSpec, ...]:
    """What a planner with a Transfuser backbone is asked with: camera, LiDAR, ego status."""
    sizes, reach = dict(backbone.input_sizes()), backbone.lidar_range
    return (
        TensorSpec("camera", "uint8", ("B", *sizes["camera"])),
        TensorSpec(
            "lidar",
            F32,
            ("B", *sizes["lidar"]),
            f"rows x, columns y, both from {-reach:g} to {reach:g} m",
            range=(0.0, 1.0),
        ),
        TensorSpec(
            "ego_status",
            F32,
            ("B", STATUS),
            "command left, straight, right, unknown: 0 or 1; velocity x, y: m/s; "
            "acceleration x, y: m/s^2",
            range=(-FASTEST, FASTEST),
        ),
    )
