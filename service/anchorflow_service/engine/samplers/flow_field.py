"""The vector field of a scene, at the times that a method asks for on a schedule.

modulate  once a scene, for all its flow times   -> modulation [K,M]
field     at each stage of each step             -> dx/dt [N,T,S]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import OdeSpec
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.graphs import BoundGraph, Graph, open_graph
from anchorflow_service.engine.parts import Arrays, Context
from anchorflow_service.engine.samplers.flow_score import PRIOR_MEAN
from anchorflow_trajectory.ode.integrate import VectorField
from anchorflow_trajectory.ode.methods import Method, method_named
from anchorflow_trajectory.ode.schedule import Schedule, stage_times

Array = NDArray[np.float32]


class FieldGraphs:
    """The graphs modulate and field of a bundle, opened.

    Raises:
        BundleError, ProviderError: as `open_graph`.
    """

    def __init__(self, bundle: Bundle, *, provider: str) -> None:
        self._modulate = open_graph(bundle, "modulate", provider=provider)
        self._field = open_graph(bundle, "field", provider=provider)

    def over(self, context: Context, sampler: OdeSpec) -> FlowField:
        """The field of a scene at the sampler's times."""
        method, schedule = method_named(sampler.method), sampler.schedule
        times = stage_times(method, schedule).times
        modulation = self._modulate(**self._modulate.select({**context, "times": times}))
        return FlowField(
            self._field, self._field.select(context), modulation["modulation"], method, schedule
        )


@dataclass(frozen=True, eq=False)
class FlowField:
    """The field graph with all that a scene gives it.

    context: its inputs that are the same for all anchors and times
    modulation: [1,K,M], one row for each distinct stage time of the method on the schedule
    """

    graph: Graph
    context: Arrays
    modulation: Array
    method: Method
    schedule: Schedule

    @property
    def times(self) -> Array:
        """The distinct stage times [K]."""
        return stage_times(self.method, self.schedule).times

    def fixed(self, mean: Array | None) -> Arrays:
        """Inputs that stay all the way; of a mixture that encode gives, each anchor's own mean.

        mean: prior means [N,T,S] that the anchors began on
        """
        own = {} if mean is None else {PRIOR_MEAN: mean[None]}
        return {**self.context, **self.graph.select(own)}

    def bound(self, mean: Array | None) -> VectorField:
        """For the anchors that began on these means, in arrays; one for each thread's."""
        return _ModulatedField(self.graph.bind(**self.fixed(mean)), self.modulation)


class _ModulatedField:
    """The bound field graph as the solver's vector field.

    modulation: [1,K,M], one row for each distinct stage time
    """

    def __init__(self, field: BoundGraph, modulation: Array) -> None:
        self._field = field
        self._modulation = modulation

    def __call__(self, x: Array, time_index: int, out: Array) -> None:
        self._field(
            {"x_t": x[None], "modulation": self._modulation[:, time_index]},
            outputs={"dx_t": out[None]},
        )
