"""What a field leaves behind: meshes, pictures, reports, and files for other programs."""

from levelflow.export.gltf import write_glb, write_morph_glb
from levelflow.export.painting import Paint, painted
from levelflow.export.paraview import write_pvd, write_vtp
from levelflow.export.ply import write_ply
from levelflow.export.printing import write_stl
from levelflow.export.scene import Scene, Up
from levelflow.export.sequences import write_sequence, write_series
from levelflow.export.snapshots import Snapshot, snapshots
from levelflow.export.tracking import TopologyChange, track
from levelflow.export.usd import write_usd
from levelflow.export.vdb import LevelSet, level_sets, write_vdb
from levelflow.export.volumes import Grid, Volume, volumes, write_mhd, write_npz

__all__ = [
    "Grid",
    "LevelSet",
    "Paint",
    "Scene",
    "Snapshot",
    "TopologyChange",
    "Up",
    "Volume",
    "level_sets",
    "painted",
    "snapshots",
    "track",
    "volumes",
    "write_glb",
    "write_mhd",
    "write_morph_glb",
    "write_npz",
    "write_ply",
    "write_pvd",
    "write_sequence",
    "write_series",
    "write_stl",
    "write_usd",
    "write_vdb",
    "write_vtp",
]
