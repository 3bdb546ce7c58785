"""The loop of a flow in the memory of the device that its graphs run on.

The field's inputs and x_0 are uploaded once, and x_1 comes back; between them only the weights of
the slopes cross. onnxruntime has no arithmetic on a device's values, so the one operation that the
loop needs is a graph of its own, the same for every bundle: see `anchorflow_export.add_scaled`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from anchorflow_client.contract import TensorSpec
from anchorflow_service.bundle.graphs import BoundGraph, Graph
from anchorflow_service.bundle.providers import Device
from anchorflow_service.engine import interfaces
from anchorflow_service.engine.samplers.flow import FlowField
from anchorflow_trajectory.ode.integrate import integrate_in

Array = NDArray[np.float32]

ADD_SCALED = Path(__file__).with_name("add_scaled.onnx")
STATES = ("B", "N", "T", "S")


class DeviceLoop:
    """Carries anchors through a flow in a device's memory; several threads may at once.

    Raises:
        ProviderError: the provider of the device's operations is not available.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._add_scaled = Graph(
            ADD_SCALED,
            inputs=[
                TensorSpec("x", "float32", STATES),
                TensorSpec("slope", "float32", STATES),
                TensorSpec("weight", "float32", ()),
            ],
            outputs=[TensorSpec("advanced", "float32", STATES)],
            provider=device.provider,
        )

    def integrate(
        self,
        field: FlowField,
        x: Array,
        mean: Array | None,
        *,
        on_step: Callable[[], object] = lambda: None,
    ) -> Array:
        """Return the states at t = 1 [N,T,S] of states x at the schedule's first time.

        mean: prior means [N,T,S] that they began on, if there are any
        on_step: called after every step; an exception that it raises ends the work
        """
        upload = self._device.upload
        fixed = {name: upload(array) for name, array in field.fixed(mean).items()}
        # One value each: a row inside a larger value would not be aligned as TensorRT requires.
        modulation = [upload(field.modulation[:, k]) for k in range(len(field.times))]
        carried = integrate_in(
            _DeviceStates(self._device, (1, *x.shape), BoundGraph(self._add_scaled, {})),
            _DeviceField(field.graphs.bind("field", fixed), modulation),
            upload(x[None]),
            schedule=field.schedule,
            method=field.method,
            on_step=lambda _: on_step(),
        )
        return carried.numpy()[0]


class _DeviceStates:
    """States [1,N,T,S] of a loop, and the sums of them, on a device."""

    def __init__(self, device: Device, shape: Sequence[int], add_scaled: BoundGraph) -> None:
        self._device, self._shape, self._add_scaled = device, shape, add_scaled

    def empty(self) -> ort.OrtValue:
        return self._device.empty(self._shape)

    def add_scaled(
        self, x: ort.OrtValue, slope: ort.OrtValue, weight: float, *, out: ort.OrtValue
    ) -> None:
        # Only the last node writes out, each number after reading x's: x and out may be the same.
        self._add_scaled(
            {"x": x, "slope": slope, "weight": np.array(weight, np.float32)},
            outputs={"advanced": out},
        )


class _DeviceField:
    """The field graph as the solver's vector field, over values on a device.

    modulation: a row [1,M] for each distinct stage time
    """

    def __init__(self, field: interfaces.BoundGraph, modulation: Sequence[ort.OrtValue]) -> None:
        self._field, self._modulation = field, modulation

    def __call__(self, x: ort.OrtValue, time_index: int, out: ort.OrtValue) -> None:
        self._field({"x_t": x, "modulation": self._modulation[time_index]}, outputs={"dx_t": out})
