"""V2X-VLM on its way to a bundle: the graphs `vision` and `encode`, and the tokenizer."""

from anchorflow_export.planners.v2x_vlm.adapter import V2XAdapter, v2x_vlm_adapter

__all__ = ["V2XAdapter", "v2x_vlm_adapter"]
