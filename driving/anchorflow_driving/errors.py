"""What is wrong with a recording, or with what is asked of it."""

from __future__ import annotations

from pathlib import Path

from anchorflow_client.errors import AnchorFlowError


class LogError(AnchorFlowError):
    """A log that cannot be used: which file, which field, what was expected, what was found."""

    def __init__(self, path: Path | str, field: str, *, expected: str, found: str) -> None:
        self.path, self.field = str(path), field
        super().__init__(f"{path}: {field}: expected {expected}, found {found}")


class SensorError(AnchorFlowError):
    """A planner asks for what no log tells."""
