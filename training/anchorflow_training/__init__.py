"""Scenes, the expert, datasets, losses and the trainer."""
