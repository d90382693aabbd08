"""Motions of the vertices of a mesh, which fields then follow."""

from levelflow.flows.densifying import AsRigidAsPossible, BlendedMotions, ThinShell, arap, thin_shell
from levelflow.flows.editing import Edit, edge_distortion, handle_error, volume_change
from levelflow.flows.flow import Flow

__all__ = [
    "AsRigidAsPossible",
    "BlendedMotions",
    "Edit",
    "Flow",
    "ThinShell",
    "arap",
    "edge_distortion",
    "handle_error",
    "thin_shell",
    "volume_change",
]
