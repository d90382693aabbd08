"""Regions of a surface and what is asked of them, for edits and deformations."""

from levelflow.handles.handle import Handle, HandleWarning, selected
from levelflow.handles.reading import handles_from, handles_in
from levelflow.handles.regions import BoxRegion, PaintedRegion, PointsRegion, Region, SphereRegion

__all__ = [
    "BoxRegion",
    "Handle",
    "HandleWarning",
    "PaintedRegion",
    "PointsRegion",
    "Region",
    "SphereRegion",
    "handles_from",
    "handles_in",
    "selected",
]
