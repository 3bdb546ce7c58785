"""A flow that follows the cost of the finish while anchors are drawn: `refine.guidance`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import RefineSpec
from anchorflow_service.bundle.manifest import Manifest, OdeEntry
from anchorflow_service.engine.conditioning.cost_map import MapScene
from anchorflow_service.engine.finish.spline import refiner_of
from anchorflow_service.engine.parts import ConditionedScene, Context
from anchorflow_service.engine.samplers.flow_field import FlowField
from anchorflow_trajectory.ode.guidance import Guidance
from anchorflow_trajectory.ode.integrate import VectorField
from anchorflow_trajectory.ode.schedule import stage_strides

Array = NDArray[np.float32]


def guidance_of(manifest: Manifest, scene: ConditionedScene, context: Context) -> Guidance | None:
    """What the request of a scene adds to the field, on the cost and style of its finish.

    Without a prior, x_0 is standard normal in every number of a state.
    """
    spec = scene.request.refine
    if not isinstance(spec, RefineSpec) or spec.guidance == 0.0:
        return None
    assert isinstance(scene, MapScene)
    assert isinstance(manifest.sampler, OdeEntry)
    prior = manifest.sampler.prior
    size = manifest.time.steps * (3 * manifest.D + 1)
    return Guidance(
        refiner_of(manifest, scene).cost(spec),
        scene.scene.ends,
        prior_basis=context[prior.basis][0] if prior else np.eye(size, dtype=np.float32),
        scale=spec.guidance,
    )


def guided(field: FlowField, mean: Array | None, guidance: Guidance | None) -> VectorField:
    """The field of the anchors that began on these means [N,T,S], corrected by guidance if any."""
    bound = field.bound(mean)
    if guidance is None:
        return bound
    strides = stage_strides(field.method, field.schedule)
    return GuidedField(bound, guidance, field.times, strides)


@dataclass(frozen=True)
class GuidedField:
    """A vector field that guidance corrects.

    times, strides: [K], each stage time, and how long the step is that asks there
    """

    field: VectorField
    guidance: Guidance
    times: Array
    strides: tuple[float, ...]

    def __call__(self, x: Array, time_index: int, out: Array) -> None:
        """Writes the corrected field at x into out, both [N,T,S]."""
        self.field(x, time_index, out)
        t, stride = float(self.times[time_index]), self.strides[time_index]
        self.guidance.correct(out, x, t, stride=stride)
