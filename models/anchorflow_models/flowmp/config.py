"""The configuration of an L2 safety-embedded flow."""

from __future__ import annotations

from dataclasses import dataclass, fields

from anchorflow_models.checks import check
from anchorflow_models.layers.attention import ACTIVATIONS
from anchorflow_models.layers.blocks import GROUPS
from anchorflow_trajectory.spline.basis import SplineBasis, spline_basis


@dataclass(frozen=True)
class TransformerSize:
    width: int
    layers: int
    heads: int


VARIANTS = {
    "small": TransformerSize(width=128, layers=4, heads=4),
    "base": TransformerSize(width=256, layers=6, heads=8),
    "large": TransformerSize(width=512, layers=8, heads=16),
}
UNET_WIDTHS = {"small": 32, "base": 64, "large": 128}  # channels at the full number of steps
BACKBONES = ("transformer", "unet")

CHOICES = {
    "variant": tuple(VARIANTS),
    "backbone": BACKBONES,
    "dim": (2, 3),
    "steps_per_token": (1, 2, 4, 8),
    "map_scales": (1, 2),
    "map_lookup": (True, False),
    "map_attention": (True, False),
    "activation": tuple(ACTIVATIONS),
}
LEAST = {
    "map_channels": 1,
    "map_size": 8,
    "feature_channels": 0,
    "degree": 3,
    "layers": 0,
    "width": 0,
    "heads": 0,
    "condition_width": 1,
    "fourier_features": 1,
}
MAP_STRIDE = 8  # the map encoder halves its window three times
ENDS_FIX = 5  # control points that p_0, v_0, a_0, p_T, v_T determine


def transformer_size(
    variant: str, *, layers: int = 0, width: int = 0, heads: int = 0
) -> TransformerSize:
    """The variant's size, with other numbers where they are given.

    Raises:
        ValueError: the width is no even multiple of the heads.
    """
    own = VARIANTS[variant]
    size = TransformerSize(width or own.width, layers or own.layers, heads or own.heads)
    fits = size.width % size.heads == 0 and size.width % 2 == 0
    check("width", fits, f"an even multiple of heads, {size.heads}", size.width)
    return size


def unet_width(variant: str, width: int = 0) -> int:
    """The variant's channels at the full number of steps, or others. Raises ValueError for those
    that its groups do not divide."""
    check("width", width % GROUPS == 0, f"a multiple of {GROUPS}", width)
    return width or UNET_WIDTHS[variant]


@dataclass(frozen=True)
class L2Config:
    """Everything that fixes the network's shape and its units.

    num_steps: T; dim: D; a third dimension is heading
    map_channels: C; map_size: cells a side of the window that the network looks at
    feature_channels: learned features to look up beside the window's own channels; 0: those alone
    steps_per_token: time steps that one transformer token covers; T need be no multiple of it
    backbone: "transformer" or "unet", the network that is the vector field
    map_scales: 2 looks at a second window besides, twice as wide and half as fine
    map_lookup: every time step reads the map's features at its own place
    map_attention: the trajectory's tokens attend to a coarse grid of map tokens
    layers, heads: of the transformer; width: of either backbone; 0: as the variant has
    activation: of the transformer's feed-forwards
    condition_width: numbers of a scene that the condition has
    fourier_features, fourier_scale: how many random rates tell flow time, and their spread

    Raises:
        ValueError: a field is out of its range; the message names it, what was expected and got.
    """

    variant: str = "small"
    num_steps: int = 64
    dim: int = 2
    map_channels: int = 3
    map_size: int = 64
    feature_channels: int = 16
    steps_per_token: int = 8
    num_control_points: int = 18
    degree: int = 4
    backbone: str = "transformer"
    map_scales: int = 1
    map_lookup: bool = True
    map_attention: bool = False
    layers: int = 0
    width: int = 0
    heads: int = 0
    activation: str = "squared_relu"
    condition_width: int = 256
    fourier_features: int = 64
    fourier_scale: float = 2.0

    def __post_init__(self) -> None:
        for field in fields(self):
            _check_type(field.name, getattr(self, field.name), type(field.default))
        for name, choices in CHOICES.items():
            check_choice(name, getattr(self, name), choices)
        for name, least in LEAST.items():
            check(name, getattr(self, name) >= least, f"at least {least}", getattr(self, name))
        size = self.map_size
        check("map_size", size % MAP_STRIDE == 0, f"a multiple of {MAP_STRIDE}", size)
        # The ends fix five control points, and a spline has more points than its degree.
        points, least = self.num_control_points, max(self.degree, ENDS_FIX) + 1
        check("num_control_points", points >= least, f"at least {least}", points)
        needed = f"at least num_control_points, {points}"
        check("num_steps", self.num_steps >= points, needed, self.num_steps)
        check("fourier_scale", self.fourier_scale > 0, "above 0", self.fourier_scale)
        if self.backbone == "unet":
            unet_width(self.variant, self.width)
        else:
            _ = self.size

    @property
    def size(self) -> TransformerSize:
        """The size of the transformer."""
        return transformer_size(
            self.variant, layers=self.layers, width=self.width, heads=self.heads
        )

    @property
    def state_dim(self) -> int:
        """S: position, its derivatives by the trajectory's own time, and log duration."""
        return 3 * self.dim + 1

    @property
    def basis(self) -> SplineBasis:
        """Return the splines of the anchors."""
        return spline_basis(
            self.num_steps, num_control_points=self.num_control_points, degree=self.degree
        )


def check_choice(name: str, value: object, choices: tuple[object, ...]) -> None:
    """Raise ValueError, naming the field, if a value is none of the choices."""
    check(name, value in choices, f"one of {', '.join(map(repr, choices))}", repr(value))


def _check_type(name: str, value: object, kind: type) -> None:
    # A whole number is a number; True is no number of steps.
    allowed = (int, float) if kind is float else kind
    fits = isinstance(value, allowed) and (kind is bool) == isinstance(value, bool)
    check(name, fits, f"a value of type {kind.__name__}", repr(value))
