"""Three shapes in time, with an equation in between and without one.

    python examples/keyframes.py [-o keyframes.png] [--steps 1200]

The first row interpolates: each surface approaches the next shape and arrives at its time. In the second row nothing is
said about the times in between, and the network has bounded slopes, which training lowers. Other constraints, and what
they cost, are compared by benchmarks/keyframes.py.

Reference:
    Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Sec. 6.3 and figure 9.
"""

import argparse

from levelflow import SIREN, Budget, Cuboid, LipschitzMLP, Sphere, Torus, contact_sheet, equations, extract, solve

TIMES = (0.0, 0.25, 0.5, 0.75, 1.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", default="keyframes.png")
    parser.add_argument("--steps", type=int, default=1200)
    options = parser.parse_args()

    keys = {0.0: Cuboid((0.8, 0.8, 0.8), radius=0.05), 0.5: Torus(0.42, 0.17), 1.0: Sphere(0.45)}
    morph = equations.Morph({t: shape for t, shape in keys.items() if t > 0})
    rows = {
        "interpolation": solve(morph, SIREN(time=1), at=keys, budget=Budget(options.steps)),
        "bounded slopes": solve(equations.Unconstrained(), LipschitzMLP(time=1), at=keys, budget=Budget(options.steps)),
    }

    meshes = [extract(field.at(t), resolution=72) for field in rows.values() for t in TIMES]
    labels = [f"{name}, t = {t:g}" for name in rows for t in TIMES]
    contact_sheet(meshes, labels, options.output, columns=len(TIMES), title="a block, a ring and a ball")
    print(options.output)


if __name__ == "__main__":
    main()
