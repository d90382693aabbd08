"""Equations of motion, the velocity fields for `Transport`, and the masks for `Regional`."""

from levelflow.equations.curvature import MeanCurvature
from levelflow.equations.eikonal import Eikonal
from levelflow.equations.equation import Equation, LevelSetEquation
from levelflow.equations.family import Family
from levelflow.equations.masks import BoxMask, PaintedMask, ProductOfMasks, SphereMask
from levelflow.equations.morph import Morph
from levelflow.equations.regional import Regional
from levelflow.equations.simplicial import SimplicialMorph
from levelflow.equations.stationary import Stationary
from levelflow.equations.transport import Constant, Rotation, Source, SumOfVelocities, Transport, Twist, VelocityField

__all__ = [
    "BoxMask",
    "Constant",
    "Eikonal",
    "Equation",
    "Family",
    "LevelSetEquation",
    "MeanCurvature",
    "Morph",
    "PaintedMask",
    "ProductOfMasks",
    "Regional",
    "Rotation",
    "SimplicialMorph",
    "Source",
    "SphereMask",
    "Stationary",
    "SumOfVelocities",
    "Transport",
    "Twist",
    "VelocityField",
]
