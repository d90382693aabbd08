"""Three shapes at the corners of a triangle, and a surface for every point of it.

    python examples/triangle.py [-o triangle.png] [--steps 1200]

On its sides the family is the morph of two shapes; inside it is a mixture of three. The sheet goes from the first shape
to the second in the first row, and up to the third in the last.

Reference:
    Novello et al., Neural homotopies (2022), Sec. 8.
"""

import argparse

from levelflow import SIREN, Budget, Cuboid, Sphere, Torus, contact_sheet, equations, extract, solve

CORNERS = ((0.0, 0.0), (1.0, 0.0), (0.5, 1.0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", default="triangle.png")
    parser.add_argument("--steps", type=int, default=1200)
    options = parser.parse_args()

    shapes = (Torus(0.45, 0.2), Cuboid((0.8, 0.8, 0.8), radius=0.05), Sphere(0.5))
    morph = equations.SimplicialMorph(CORNERS, shapes)
    field = solve(morph, SIREN(time=2), at=morph.keys, budget=Budget(options.steps))

    places = (
        [(s, 0.0) for s in (0.0, 0.5, 1.0)]
        + [(s, 0.5) for s in (0.25, 0.5, 0.75)]
        + [(0.4, 0.8), (0.5, 1.0), (0.6, 0.8)]
    )
    meshes = [extract(field.at(*p), resolution=72) for p in places]
    labels = [f"({s:g}, {t:g})" for s, t in places]
    contact_sheet(meshes, labels, options.output, columns=3, title="a torus, a cube and a sphere at the corners")
    print(options.output)


if __name__ == "__main__":
    main()
