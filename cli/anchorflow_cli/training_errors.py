"""What goes wrong in training is one line on the command line, like every other error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from anchorflow_client.errors import AnchorFlowError
from anchorflow_training.checkpoint import CheckpointError
from anchorflow_training.dataset import DatasetError
from anchorflow_training.divergence import DivergenceError
from anchorflow_training.settings import ConfigError


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Training's errors as an `AnchorFlowError`, which `main` prints."""
    try:
        yield
    except (CheckpointError, ConfigError, DatasetError, DivergenceError) as error:
        raise AnchorFlowError(str(error)) from error
