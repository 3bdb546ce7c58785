"""What goes wrong between a checkpoint and a bundle."""

from anchorflow_client.errors import AnchorFlowError


class ExportError(AnchorFlowError):
    """A model could not be exported, or its graphs do not give what torch gives."""
