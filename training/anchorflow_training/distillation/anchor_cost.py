"""The cost of a student's anchors before the finish: `TrajectoryCost` in torch.

The finish fits a spline that meets both ends to each anchor, in the duration that the anchor has,
and descends the expert's cost from there. A student whose ends cost little leaves it little to do.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from anchorflow_models import L2Config
from anchorflow_models.layers.clearance_map import ClearanceMap
from anchorflow_models.layers.geometry import in_float32
from anchorflow_trajectory.cost.fields import RISK
from anchorflow_trajectory.cost.kernels import DEEP
from anchorflow_trajectory.cost.trajectory_cost import STEEP, CostWeights
from anchorflow_trajectory.motion import TURN
from anchorflow_trajectory.scene import COST_PENALTY
from anchorflow_trajectory.spline.basis import END_ORDERS

WEIGHTS = CostWeights()  # the expert's
LEAST_SQUARE = 1e-18  # beside a squared size, whose root then has a slope at rest too


class AnchorCost(nn.Module):
    """J of anchors [B, N] as `Refiner` fits them, differentiable in their states.

    margin: m of clearance of the hard hinge, as in the bundle's finish
    """

    ends: Tensor  # [K, 5] as of `SplineBasis`
    stacked: Tensor  # [K, 4T]
    fit: Tensor  # [3T, F]

    def __init__(self, config: L2Config, *, margin: float) -> None:
        super().__init__()
        basis = config.basis
        self.dim, self.free, self.margin = config.dim, basis.free, margin
        arrays = {"ends": basis.ends, "stacked": basis.stacked, "fit": basis.fit_matrix.T}
        for name, array in arrays.items():
            tensor = torch.from_numpy(array.copy()).float()
            self.register_buffer(name, tensor, persistent=False)

    @in_float32
    def forward(self, states: Tensor, inputs: Mapping[str, Tensor], reference_s: Tensor) -> Tensor:
        """J [B, N] of states [B, N, T, 3D + 1]: p, p', p'' in own time [m], and log duration.

        inputs: of encode; reference_s: [B] s, as of `TrajectoryCost`
        """
        states = states.float()
        horizon_s = inputs["limits"][:, 3:]
        duration = torch.exp(states[..., -1].mean(-1))
        duration = torch.where(horizon_s > 0, horizon_s, duration)
        samples = self._fitted(states[..., :-1], inputs, duration) @ self.stacked
        return self._cost(samples.unflatten(-1, (4, -1)), duration, inputs, reference_s)

    def _fitted(self, states: Tensor, inputs: Mapping[str, Tensor], duration: Tensor) -> Tensor:
        """Control points [B, N, D, K] that meet both ends and lie nearest to [B, N, T, 3D]."""
        ends = torch.cat([inputs["x_curr"], inputs["x_goal"]], -1).unflatten(-1, (5, self.dim))
        scale = duration[..., None] ** torch.from_numpy(END_ORDERS).to(duration)
        fixed = torch.einsum("ke,bed,bne->bndk", self.ends, ends, scale)
        fields = states.unflatten(-1, (3, self.dim)).permute(0, 1, 4, 3, 2).flatten(-2)
        free = (fields - fixed @ self.stacked[:, : fields.shape[-1]]) @ self.fit
        beside = (self.free.start, fixed.shape[-1] - self.free.stop)
        return fixed + nn.functional.pad(free, beside)

    def _cost(
        self, samples: Tensor, duration: Tensor, inputs: Mapping[str, Tensor], reference_s: Tensor
    ) -> Tensor:
        """J [B, N] of p and its first three derivatives by own time [B, N, D, 4, T]."""
        w = WEIGHTS
        position, first, second, third = samples.unbind(-2)
        lean = inputs["w_style"] ** w.contrast
        safety, energy, smooth = (lean / lean.sum(-1, keepdim=True)).T[:, :, None, None]
        v_max, a_max = inputs["limits"].T[:2, :, None, None]
        jerk_scale = torch.minimum(a_max, v_max**2 / TURN) ** 2 / v_max
        reference_s = reference_s[:, None]
        pace = 1.0 / duration[..., None]
        by_speed, by_acceleration = pace / v_max, pace**2 / a_max
        by_way = 1.0 / (v_max * reference_s[..., None])
        slow_gain, short_gain = safety * w.slow * by_speed**2, energy * w.short * by_way**2

        places, surcharge = position.movedim(-2, -1), surcharge_of(inputs["cost_map"])
        steep = (surcharge.amax((1, 2)) / STEEP).clamp(min=1.0)[:, None, None]
        cost = self._near_obstacles(places, w.collision * steep, safety * w.safety, inputs)
        way = (_squared(first[:, :, :2]) + LEAST_SQUARE).sqrt() * by_way
        cost = cost + w.dear * way * _price(places, surcharge, inputs["map_geometry"])
        cost = cost + (slow_gain + short_gain) * _squared(first)
        cost = cost + smooth * w.smooth * (pace**3 / jerk_scale) ** 2 * _squared(third)
        hinges = ((first, by_speed, w.speed), (second, by_acceleration, w.acceleration))
        for vectors, share, gain in hinges:
            size = (_squared(vectors[:, :, :2]) + LEAST_SQUARE).sqrt() * share
            cost = cost + gain * steep * (size - w.limit_share).clamp(min=0).square()
        later = (w.time + w.quick * energy[..., 0]) * duration / reference_s
        return cost.mean(-1) + later

    def _near_obstacles(
        self, points: Tensor, collision: Tensor, safety: Tensor, inputs: Mapping[str, Tensor]
    ) -> Tensor:
        """Cost [B, N, T] of how near obstacles points [B, N, T, D] lie."""
        w, geometry = WEIGHTS, inputs["map_geometry"]
        clearance = ClearanceMap(inputs["clearance_field"], geometry)(points)
        hard = (self.margin - clearance).clamp(min=0)
        lack = (1.0 - clearance / w.comfort).clamp(min=0)
        deep = hard.clamp(max=DEEP)
        return collision * deep * (2.0 * hard - deep) + safety * lack.square()


def _price(points: Tensor, surcharge: Tensor, geometry: Tensor) -> Tensor:
    """1 + surcharge [B, N, T] where points [B, N, T, D] lie; 0 on maps [B, H, W] without any."""
    is_dear = surcharge.flatten(1).any(1)[:, None, None]
    return torch.where(is_dear, 1.0 + ClearanceMap(surcharge, geometry)(points), 0.0)


def surcharge_of(cost_map: Tensor) -> Tensor:
    """Return the surcharge [B, H, W] that networks' maps [B, C, H, W] tell: `Scene.network_map`."""
    risk = cost_map[:, RISK]
    return COST_PENALTY * risk / (1.0 - risk)


def _squared(vectors: Tensor) -> Tensor:
    """Squared sizes [B, N, T] of [B, N, D, T]."""
    return vectors.square().sum(-2)
