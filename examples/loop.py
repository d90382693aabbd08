"""A loop without a seam, as stop-motion: a torus becomes a ball, a block and a torus again, with a rest at each.

    python examples/loop.py [-o loop.png] [--steps 1200]

The network is periodic in time, so that the film closes with all of its derivatives; keys then ease it to rest at each
shape, and hold it there. The picture has a moment in each frame; beside it the film, loop.gif, runs for ever.
"""

import argparse
from pathlib import Path

from levelflow import (
    SIREN,
    Budget,
    Cuboid,
    Periodic,
    Retimed,
    Sphere,
    Torus,
    contact_sheet,
    equations,
    extract,
    film,
    solve,
)

SECONDS, HOLD = 4.5, 0.5
"""Of the whole film, and of the rest at each shape."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", default="loop.png")
    parser.add_argument("--steps", type=int, default=1200)
    options = parser.parse_args()

    torus, ball, block = Torus(0.5, 0.2), Sphere(0.45), Cuboid((0.9, 0.6, 0.6), radius=0.08)
    field = solve(
        equations.Morph({1 / 3: ball, 2 / 3: block, 1.0: torus}),
        Periodic(SIREN(3, 2), time=True),
        at={0.0: torus, 1 / 3: ball, 2 / 3: block},
        until=1.0,
        budget=Budget(options.steps),
    )

    # Each shape comes to rest, holds, and leaves: two keys with the same old time.
    each = SECONDS / 3
    keys = {i * each + wait: i / 3 for i in range(3) for wait in (0.0, HOLD)} | {SECONDS: 1.0}
    eased = Retimed(field, keys)

    times = [SECONDS * i / 12 for i in range(12)]
    meshes = [extract(eased.at(t), resolution=72) for t in times]
    contact_sheet(meshes, [f"t = {t:g} s" for t in times], options.output, columns=4, title="a loop, eased")
    moving = Path(options.output).with_suffix(".gif")
    film(eased, moving, times=[SECONDS * i / 36 for i in range(36)], rate=8, size=256, resolution=56)
    print(f"{options.output}, {moving}")


if __name__ == "__main__":
    main()
