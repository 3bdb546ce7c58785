"""The configuration of a Transfuser backbone, and the ego status beside it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from anchorflow_models.checks import check

STATUS = 8
"""Numbers: the command as one of four, velocity x and y, acceleration x and y."""
STATUS_UNITS = (1.0,) * 4 + (10.0,) * 2 + (3.0,) * 2
"""What each is usually as large as: m/s and m/s²."""
MOTION = slice(4, 8)
"""The status's velocity and acceleration."""


STEM_STRIDE = 2
SEMANTIC_STRIDE = 4
LIDAR_BEFORE = "lidar_before"
"""The input that shows an earlier sweep of the LiDAR, in the frame of now."""


@dataclass(frozen=True)
class TransfuserConfig:
    """Everything that fixes the backbone's shapes; the defaults are the published ones.

    image_height, image_width: pixels of the stitched camera image
    lidar_size: cells a side of the LiDAR histogram; lidar_range: m from its middle to its edges
    stem_width: channels of each ResNet's first convolution
    widths, depths: channels and residual blocks of each stage; ResNet-34: 64 … 512 and 3, 4, 6, 3
    stem_pooling: each ResNet halves its input once more before the first stage
    fusion_layers, fusion_heads: of the transformer between image and LiDAR after each stage
    bev_channels: of the upscaled BEV
    pyramid_skips: the upscaled BEV also sees the LiDAR's earlier stages; published is without
    lidar_before: an earlier sweep of the LiDAR is read beside that of now; published is without

    Raises:
        ValueError: a field is out of its range; the message names it, what was expected and got.
    """

    image_height: int = 256
    image_width: int = 1024
    lidar_size: int = 256
    lidar_range: float = 32.0
    stem_width: int = 64
    widths: tuple[int, ...] = (64, 128, 256, 512)
    depths: tuple[int, ...] = (3, 4, 6, 3)
    stem_pooling: bool = True
    fusion_layers: int = 2
    fusion_heads: int = 4
    bev_channels: int = 64
    pyramid_skips: bool = False
    lidar_before: bool = False

    def __post_init__(self) -> None:
        for name, least in (("stem_width", 1), ("fusion_heads", 1), ("bev_channels", 1)):
            value = getattr(self, name)
            check(name, value >= least, f"at least {least}", value)
        check("fusion_layers", self.fusion_layers >= 0, "at least 0", self.fusion_layers)
        check("lidar_range", self.lidar_range > 0, "more than 0", self.lidar_range)
        check("widths", len(self.widths) > 0, "a stage or more", self.widths)
        alike = len(self.depths) == len(self.widths)
        check("depths", alike, f"{len(self.widths)} numbers, one a stage", self.depths)
        check("depths", min(self.depths) >= 1, "at least 1 each", self.depths)
        heads = self.fusion_heads
        fits = all(width >= 1 and width % heads == 0 for width in self.widths)
        check("widths", fits, f"multiples of fusion_heads, {heads}", self.widths)
        for name in ("image_height", "image_width", "lidar_size"):
            size = getattr(self, name)
            whole = size >= self.stride and size % self.stride == 0
            check(name, whole, f"a multiple of {self.stride}", size)
        whole = self.lidar_size % SEMANTIC_STRIDE == 0
        check("lidar_size", whole, f"a multiple of {SEMANTIC_STRIDE}", self.lidar_size)

    @property
    def stride(self) -> int:
        """Input cells a side of a cell of the last stage."""
        return STEM_STRIDE * (2 if self.stem_pooling else 1) * 2 ** (len(self.widths) - 1)

    @property
    def image_grid(self) -> tuple[int, int]:
        """Rows and columns of the image's tokens."""
        return self.image_height // self.stride, self.image_width // self.stride

    @property
    def bev_size(self) -> int:
        """Cells a side of the BEV features."""
        return self.lidar_size // self.stride

    @property
    def bev_width(self) -> int:
        """Channels of the BEV features."""
        return self.widths[-1]

    @property
    def upscaled_size(self) -> int:
        """Cells a side of the upscaled BEV."""
        return self.lidar_size // SEMANTIC_STRIDE

    @property
    def upscaled_cell(self) -> float:
        """m, a side of a cell of the upscaled BEV."""
        return 2 * self.lidar_range / self.upscaled_size

    @property
    def ground_ahead(self) -> float:
        """Offset in m of a BEV of the road ahead from the LiDAR's square: three eighths of its
        side, which leaves an eighth behind the ego.
        """
        return self.ground_rows * self.upscaled_cell

    @property
    def ground_rows(self) -> int:
        """The same in cells of the upscaled BEV."""
        return 3 * self.upscaled_size // 8

    @property
    def far_size(self) -> tuple[int, int]:
        """Rows and columns of cells beyond the LiDAR's square, straight ahead: five eighths of its
        side, both.
        """
        side = 2 * (5 * self.upscaled_size // 16)
        return side, side

    @property
    def far_range(self) -> float:
        """m, by which these reach farther."""
        return self.far_size[0] * self.upscaled_cell

    @property
    def semantic_size(self) -> tuple[int, int]:
        """Rows and columns of the semantic BEV, which is the half before the ego."""
        return self.lidar_size // 2, self.lidar_size

    def input_sizes(self) -> Iterator[tuple[str, tuple[int, ...]]]:
        """Yield the backbone's inputs by name, and their axes without B."""
        yield "camera", (3, self.image_height, self.image_width)
        yield "lidar", (1, self.lidar_size, self.lidar_size)
        if self.lidar_before:
            yield LIDAR_BEFORE, (1, self.lidar_size, self.lidar_size)
