"""Flows that move the vertices of a mesh."""
