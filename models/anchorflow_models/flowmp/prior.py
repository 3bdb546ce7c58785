"""The noise that the flow starts from: smooth trajectories that already meet both ends.

x_0 is the rest curve plus a Gaussian in the free control points, so it is a trajectory whose
velocity and acceleration belong to its position, as in the data. The covariance is the data's own
(residuals from the rest curve, in the scene's axes and window half sizes): a flow between
distributions of equal first and second moments has the least way to go.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.flowmp.frame import Frame
from anchorflow_trajectory.spline import SplineBasis, spline_basis

FIELDS = 3  # position, velocity, acceleration
ENDS = 5  # p_0, v_0, a_0, p_T, v_T


class TrajectoryPrior(nn.Module):
    """Rest curve and noise of each scene, and the units in which the network works."""

    curve: Tensor  # [T, 3, 5] states of the rest curve from the end states
    free: Tensor  # [F, T, 3] states of each free control point
    factor: Tensor  # [R, D, F] control-point noise of each unit of noise
    spread: Tensor  # [3, D] standard deviation of the states' residuals

    def __init__(self, config: L2Config) -> None:
        super().__init__()
        self.dim = config.dim
        basis = spline_basis(
            config.num_steps,
            config.horizon_s,
            num_control_points=config.num_control_points,
            degree=config.degree,
        )
        self.register_buffer("curve", _rest_states(basis))
        self.register_buffer("free", _free_states(basis))
        self.register_buffer("factor", torch.zeros(self.rank, self.dim, self.free.shape[0]))
        self.register_buffer("spread", torch.ones(FIELDS, self.dim))
        self.set_covariance(0.02 * np.eye(self.rank))

    @property
    def rank(self) -> int:
        """R: numbers of noise a trajectory."""
        return self.dim * self.free.shape[0]

    def set_covariance(self, covariance: np.ndarray) -> None:
        """Take the residual control points' covariance [R, R], in (D, F) order and half sizes."""
        ridge = 1e-6 * np.trace(covariance) / self.rank * np.eye(self.rank)
        root = np.linalg.cholesky(np.asarray(covariance, np.float64) + ridge).T
        self.factor.copy_(torch.from_numpy(root).reshape(self.factor.shape))
        states = torch.einsum("rdf,ftk->rtkd", self.factor, self.free)
        self.spread.copy_(states.square().sum(0).mean(0).sqrt())

    def widen(self, scale: float) -> None:
        """Draw noise `scale` times as wide; above 1 more alternatives, each less typical."""
        self.factor.mul_(scale)

    def mean(self, x_curr: Tensor, x_goal: Tensor) -> Tensor:
        """The rest curves' states, [B, T, S] in SI and the map's frame."""
        ends = torch.cat([x_curr, x_goal], -1).reshape(-1, ENDS, self.dim)
        return torch.einsum("tke,bed->btkd", self.curve, ends).flatten(2)

    def basis(self, frame: Frame) -> Tensor:
        """States of each unit of noise, [B, R, T * S] in SI and the map's frame."""
        states = torch.einsum("rdf,ftk->rtkd", self.factor, self.free)[None]
        states = states * frame.half_size[:, None, None, None, None]
        return frame.turn_out(states).flatten(2)

    def units(self, frame: Frame) -> Tensor:
        """[B, S, S]: what turns SI residuals (rows) into the scene's axes, at unit spread."""
        turn = frame.rotation / frame.half_size[:, None, None]
        return (self._diagonal(turn) / self.spread).flatten(3).flatten(1, 2)

    def si_units(self, frame: Frame) -> Tensor:
        """[B, S, S]: the inverse of `units`."""
        turn = frame.rotation.transpose(1, 2) * frame.half_size[:, None, None]
        return (self._diagonal(turn) * self.spread[:, :, None, None]).flatten(3).flatten(1, 2)

    def normalise(self, x: Tensor, mean: Tensor, units: Tensor) -> Tensor:
        """States [B, N, T, S] in SI as residuals of unit spread in the scene's axes."""
        return ((x - mean[:, None]).flatten(1, 2) @ units).reshape(x.shape)

    def to_si(self, field: Tensor, si_units: Tensor) -> Tensor:
        """A field [B, N, T, S] of the normalised states as one of the SI states."""
        return (field.flatten(1, 2) @ si_units).reshape(field.shape)

    def _diagonal(self, turn: Tensor) -> Tensor:
        """[B, D, D] -> [B, FIELDS, D, FIELDS, D], the same for position, velocity, acceleration."""
        return torch.eye(FIELDS, device=turn.device)[:, None, :, None] * turn[:, None, :, None, :]


def _rest_states(basis: SplineBasis) -> Tensor:
    ends = np.concatenate([_unit_curve(basis, end) for end in range(ENDS)], -1)
    return torch.from_numpy(ends)


def _unit_curve(basis: SplineBasis, end: int) -> np.ndarray:
    """[T, 3, 1]: the rest curve whose end states are zero but for one."""
    ends = np.zeros(ENDS, np.float32)
    ends[end] = 1.0
    control = basis.rest_curve(ends[:FIELDS], ends[FIELDS:])
    return np.stack([a[0] for a in basis.states(control[:, None])], 1)


def _free_states(basis: SplineBasis) -> Tensor:
    orders = (basis.position, basis.velocity, basis.acceleration)
    return torch.from_numpy(np.stack([order[:, basis.free].T for order in orders], -1))
