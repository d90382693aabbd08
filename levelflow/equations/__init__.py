"""Equations of motion, the velocity fields for `Transport`, and the masks for `Regional`."""

from levelflow.equations.approach import Approach
from levelflow.equations.curvature import MeanCurvature
from levelflow.equations.eikonal import Eikonal
from levelflow.equations.equation import Equation, LevelSetEquation
from levelflow.equations.family import Family
from levelflow.equations.features import FeaturePreserving
from levelflow.equations.heat import Heat
from levelflow.equations.masks import BoxMask, PaintedMask, ProductOfMasks, SphereMask
from levelflow.equations.morph import Morph
from levelflow.equations.regional import Regional
from levelflow.equations.simplicial import SimplicialMorph
from levelflow.equations.stationary import Stationary
from levelflow.equations.transport import Constant, Rotation, Source, SumOfVelocities, Transport, Twist, VelocityField
from levelflow.equations.unconstrained import Unconstrained
from levelflow.equations.volume import VolumePreserving
from levelflow.equations.willmore import Willmore

__all__ = [
    "Approach",
    "BoxMask",
    "Constant",
    "Eikonal",
    "Equation",
    "Family",
    "FeaturePreserving",
    "Heat",
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
    "Unconstrained",
    "VelocityField",
    "VolumePreserving",
    "Willmore",
]
