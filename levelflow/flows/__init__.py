"""Flows: what moves the vertices of a mesh, for fields to follow."""

from levelflow.flows.curvature import MeanCurvature, Taubin
from levelflow.flows.densifying import AsRigidAsPossible, BlendedMotions, ThinShell, arap, thin_shell
from levelflow.flows.descent import Descent, area, dirichlet
from levelflow.flows.editing import Edit, edge_distortion, handle_error, volume_change
from levelflow.flows.flow import Flow, SumOfFlows
from levelflow.flows.prescribed import NormalOffset, Prescribed
from levelflow.flows.volume import VolumePreserving

__all__ = [
    "AsRigidAsPossible",
    "BlendedMotions",
    "Descent",
    "Edit",
    "Flow",
    "MeanCurvature",
    "NormalOffset",
    "Prescribed",
    "SumOfFlows",
    "Taubin",
    "ThinShell",
    "VolumePreserving",
    "arap",
    "area",
    "dirichlet",
    "edge_distortion",
    "handle_error",
    "thin_shell",
    "volume_change",
]
