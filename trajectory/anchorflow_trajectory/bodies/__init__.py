"""Robots with an outline and a heading: ways that they fit through and that they can drive."""
