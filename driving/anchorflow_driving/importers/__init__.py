"""Logs of other layouts. Each importer names file, field, expected and found where one is wrong."""
