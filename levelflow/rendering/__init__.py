"""Pictures of surfaces, without a GPU or a display."""

from levelflow.rendering.camera import Camera
from levelflow.rendering.colours import ColourMap, Scale
from levelflow.rendering.differentiable import differentiable_image
from levelflow.rendering.film import film, orbit, write_film
from levelflow.rendering.hits import Hits
from levelflow.rendering.images import contact_sheet, image, write
from levelflow.rendering.quantities import Curvature, Quantity, Residual, mesh_curvature
from levelflow.rendering.rasterising import Raster, rasterise
from levelflow.rendering.shading import Clay, Normals, shade
from levelflow.rendering.tracing import framed, sphere_trace

__all__ = [
    "Camera",
    "Clay",
    "ColourMap",
    "Curvature",
    "Hits",
    "Normals",
    "Quantity",
    "Raster",
    "Residual",
    "Scale",
    "contact_sheet",
    "differentiable_image",
    "film",
    "framed",
    "image",
    "mesh_curvature",
    "orbit",
    "rasterise",
    "shade",
    "sphere_trace",
    "write",
    "write_film",
]
