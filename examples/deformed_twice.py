"""A bar that is bent, and then twisted: a deformed field is a field like any other, and is deformed again.

    python examples/deformed_twice.py [-o deformed_twice.png] [--steps 400]

The first deformation turns the upper end of a bar by 60 degrees; the second turns that end, where it now is, by 90
degrees about its own axis. What is printed is how far the handles are missed and how the volume changes.

Reference:
    Yang et al., Geometry Processing with Neural Fields, NeurIPS 2021, Sec. 5, where a deformed field cannot be edited.
"""

import argparse
import math

import numpy as np

from levelflow import SIREN, Box, Budget, Camera, Cuboid, contact_sheet, deform, extract, fit
from levelflow.handles import BoxRegion, Handle, SphereRegion

ANGLE = 60


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", default="deformed_twice.png")
    parser.add_argument("--steps", type=int, default=400)
    options = parser.parse_args()

    field = fit(SIREN(), Cuboid((0.3, 0.3, 1.6), radius=0.04), budget=Budget(options.steps))
    lower_end = Handle.fix(BoxRegion(Box((-1.0, -1.0, -1.0), (1.0, 1.0, -0.55))))
    upper_end = BoxRegion(Box((-1.0, -1.0, 0.55), (1.0, 1.0, 1.0)))
    bend = Handle.rotate(upper_end, angle=ANGLE, axis=(0, 1, 0), center=(0, 0, 0))

    along = (math.sin(math.radians(ANGLE)), 0.0, math.cos(math.radians(ANGLE)))
    tip = tuple(0.675 * a for a in along)
    twist = Handle.rotate(SphereRegion(tip, 0.3), angle=90, axis=along, center=tip)

    fields = [field]
    for name, handle in (("bent", bend), ("twisted", twist)):
        fields.append(deform(fields[-1], [lower_end, handle], budget=Budget(options.steps), n=512))
        missed = fields[-1].provenance["handles"]
        print(f"{name}: handles missed by {missed['mean']:.1e}, at most {missed['max']:.1e}")
    meshes = [extract(f, resolution=96, refine=2) for f in fields]
    print("volumes:", ", ".join(f"{mesh.volume:.4f}" for mesh in meshes))
    points = np.concatenate([mesh.vertices for mesh in meshes])
    camera = Camera.around(points, azimuth=-20, elevation=15, up=(0.0, 0.0, 1.0))
    labels = ["at rest", "bent", "then twisted"]
    contact_sheet(meshes, labels, options.output, camera=camera, title="a bar deformed twice")
    print(options.output)


if __name__ == "__main__":
    main()
