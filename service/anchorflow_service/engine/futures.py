"""Predictions of the other road users, by a graph beside the planner's."""

from __future__ import annotations

import numpy as np

from anchorflow_client.contract.batch import FUTURES
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.sensors import KIND, KINDS
from anchorflow_service.bundle.manifest import OTHERS, Manifest
from anchorflow_service.engine.interfaces import Arrays, ConditionedScene, Graphs


class OthersFutures:
    """Predicts the others of a scene by the graph `futures`."""

    def __init__(self, manifest: Manifest, graphs: Graphs) -> None:
        self._graph, self._graphs = manifest.graphs[FUTURES], graphs
        self.names = self._graph.output_names

    @staticmethod
    def told(scene: ConditionedScene) -> bool:
        """Return whether a request tells who else is there."""
        return OTHERS in scene.request.inputs

    def predict(self, scene: ConditionedScene) -> Arrays:
        """Return the graph's outputs [A, …] of a scene, if its request tells or asks of the others.

        Rows after the last of the others are not computed, but zeros. Raises `InvalidRequest` if a
        kind is unknown.
        """
        if not (self.told(scene) or {*self.names} & {*scene.request.outputs}):
            return {}
        inputs = scene.inputs(self._graph.input_names)
        others = inputs[OTHERS]
        if not np.isin(others[..., KIND], (0, *KINDS)).all():
            raise InvalidRequest("expected kinds 0, 1, 2 or 3", f"inputs.{OTHERS}")
        used = np.flatnonzero(others[0].any((1, 2)))
        count = int(used[-1]) + 1 if len(used) else 1
        given = self._graphs.run(FUTURES, {**inputs, OTHERS: others[:, :count]})
        left = others.shape[1] - count
        return {
            name: np.pad(given[name][0], [(0, left)] + [(0, 0)] * (given[name].ndim - 2))
            for name in self.names
        }
