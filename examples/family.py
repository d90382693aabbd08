"""A family with two parameters: how far a block is bent into a twist, and how far it has become round.

    python examples/family.py [-o family.png] [--steps 1200]

One network holds every combination; the picture is a gallery of some of them, twist along the rows and smoothing down
the columns. The two motions do not commute exactly, so that training settles between the two orders.

Reference:
    Novello et al., Neural homotopies (2022), Secs. 3.3 and 4.1.3.
"""

import argparse

from levelflow import SIREN, Budget, Cuboid, contact_sheet, equations, extract, solve

TWISTS, TIMES = (0.0, 0.5, 1.0), (0.0, 0.5, 1.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", default="family.png")
    parser.add_argument("--steps", type=int, default=1200)
    options = parser.parse_args()

    twist = equations.Transport(equations.Twist(rate=2.0))
    smooth = equations.MeanCurvature(rate=0.01)
    block = Cuboid((0.5, 1.0, 0.4), radius=0.05)
    field = solve(
        equations.Family(twist, smooth),
        SIREN(time=2),
        at={(0.0, 0.0): block},
        until=(TWISTS[-1], TIMES[-1]),
        budget=Budget(options.steps),
    )

    gallery = [(s, t) for t in TIMES for s in TWISTS]
    meshes = [extract(field.at(s, t), resolution=72) for s, t in gallery]
    labels = [f"twist {s:g}, time {t:g}" for s, t in gallery]
    contact_sheet(meshes, labels, options.output, columns=len(TWISTS), title="one field, two parameters")
    print(options.output)


if __name__ == "__main__":
    main()
