"""Surfaces to start from: meshes, point clouds and solids with a formula."""

from levelflow.shapes.analytic import Capsule, Circle, Cuboid, Cylinder, Dumbbell, Polygon, Rectangle, Sphere, Torus
from levelflow.shapes.cloud import PointCloud
from levelflow.shapes.combined import Rotated, SmoothUnion, Translated
from levelflow.shapes.level import Level
from levelflow.shapes.mesh import Mesh, MeshWarning, SignUncertainty
from levelflow.shapes.shape import Samples, Shape, Solid

__all__ = [
    "Capsule",
    "Circle",
    "Cuboid",
    "Cylinder",
    "Dumbbell",
    "Level",
    "Mesh",
    "MeshWarning",
    "PointCloud",
    "Polygon",
    "Rectangle",
    "Rotated",
    "Samples",
    "Shape",
    "SignUncertainty",
    "SmoothUnion",
    "Solid",
    "Sphere",
    "Torus",
    "Translated",
]
