"""The anchorflow command."""
