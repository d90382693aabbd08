"""Flows: what moves the vertices of a mesh."""

from levelflow.flows.curvature import MeanCurvature, Taubin
from levelflow.flows.descent import Descent, area, dirichlet
from levelflow.flows.flow import Flow, SumOfFlows
from levelflow.flows.prescribed import NormalOffset, Prescribed
from levelflow.flows.volume import VolumePreserving

__all__ = [
    "Descent",
    "Flow",
    "MeanCurvature",
    "NormalOffset",
    "Prescribed",
    "SumOfFlows",
    "Taubin",
    "VolumePreserving",
    "area",
    "dirichlet",
]
