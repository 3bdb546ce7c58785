"""WoTE as a bundle: two graphs and a vocabulary."""

from anchorflow_export.planners.wote.adapter import WoteAdapter, wote_adapter

__all__ = ["WoteAdapter", "wote_adapter"]
