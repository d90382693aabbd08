"""levelflow: evolving neural implicit surfaces.

Every surface is the zero set of a field; every method pushes jets through it. The public names are loaded when they
are first used, so that importing the package costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from levelflow._version import __version__

_HOMES = {
    "Box": "boxes",
    "Budget": "minimising",
    "Bar": "progress",
    "Camera": "rendering",
    "Capsule": "shapes",
    "Checkpoint": "saving",
    "Circle": "shapes",
    "Cuboid": "shapes",
    "Cylinder": "shapes",
    "Continued": "fields",
    "Deformed": "fields",
    "Divergence": "minimising",
    "Dumbbell": "shapes",
    "EmptyLevelSet": "extraction",
    "Field": "fields",
    "Frame": "boxes",
    "Implicit": "shapes.implicit",
    "Inverse": "networks.invertible",
    "InvertibleResNet": "networks.invertible",
    "Jet": "jets",
    "Keyframed": "keyframed",
    "Level": "shapes",
    "LipschitzMLP": "networks.lipschitz",
    "Map": "fields",
    "Mesh": "shapes",
    "MeshWarning": "shapes",
    "Periodic": "networks.periodic",
    "Placed": "fields",
    "PointCloud": "shapes",
    "Polygon": "shapes",
    "Rectangle": "shapes",
    "Retimed": "retimed",
    "Rotated": "shapes",
    "SIREN": "networks.siren",
    "Shell": "elasticity",
    "Sampling": "conditions",
    "SmoothUnion": "shapes",
    "Sphere": "shapes",
    "Torus": "shapes",
    "Translated": "shapes",
    "Transported": "transported",
    "contact_sheet": "rendering",
    "deform": "deformation",
    "evolve": "evolution",
    "extract": "extraction",
    "film": "rendering",
    "fit": "fitting",
    "image": "rendering",
    "lift": "networks.lifting",
    "load": "saving",
    "sample_surface": "shapes.sampling",
    "save": "saving",
    "scale_curvature": "filtering",
    "sliced": "networks.siren",
    "solve": "solving",
}
_MODULES = ("curvature", "equations", "export", "fields", "flows", "handles", "jets", "measures", "rendering", "shapes")

__all__ = ["__version__", *_HOMES, *_MODULES]

if TYPE_CHECKING:
    from levelflow import curvature, equations, export, fields, flows, handles, jets, measures, rendering, shapes
    from levelflow.boxes import Box, Frame
    from levelflow.conditions import Sampling
    from levelflow.deformation import deform
    from levelflow.elasticity import Shell
    from levelflow.evolution import evolve
    from levelflow.extraction import EmptyLevelSet, extract
    from levelflow.fields import Continued, Deformed, Field, Map, Placed
    from levelflow.filtering import scale_curvature
    from levelflow.fitting import fit
    from levelflow.jets import Jet
    from levelflow.keyframed import Keyframed
    from levelflow.minimising import Budget, Divergence
    from levelflow.networks.invertible import Inverse, InvertibleResNet
    from levelflow.networks.lifting import lift
    from levelflow.networks.lipschitz import LipschitzMLP
    from levelflow.networks.periodic import Periodic
    from levelflow.networks.siren import SIREN, sliced
    from levelflow.progress import Bar
    from levelflow.rendering import Camera, contact_sheet, film, image
    from levelflow.retimed import Retimed
    from levelflow.saving import Checkpoint, load, save
    from levelflow.shapes import (
        Capsule,
        Circle,
        Cuboid,
        Cylinder,
        Dumbbell,
        Level,
        Mesh,
        MeshWarning,
        PointCloud,
        Polygon,
        Rectangle,
        Rotated,
        SmoothUnion,
        Sphere,
        Torus,
        Translated,
    )
    from levelflow.shapes.implicit import Implicit
    from levelflow.shapes.sampling import sample_surface
    from levelflow.solving import solve
    from levelflow.transported import Transported


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f"levelflow.{_HOMES[name]}"), name)
    if name in _MODULES:
        return importlib.import_module(f"levelflow.{name}")
    raise AttributeError(f"module 'levelflow' has no attribute {name!r}; it has {', '.join(__all__)}.")


def __dir__() -> list[str]:
    return sorted(__all__)
