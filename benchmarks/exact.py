"""Where surfaces are, compared with exact solutions: `levelflow bench` on the bunny.

    python benchmarks/exact.py [CASE ...] [--steps N] [--mesh FILE]

The mesh is `bunny.obj` of the folder LEVELFLOW_MESHES, or of ../shared/meshes beside the repository, unless another is
named. Exit code 1 if a limit is missed.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from levelflow.cli import main

if __name__ == "__main__":
    if "--mesh" not in sys.argv:
        folder = Path(os.environ.get("LEVELFLOW_MESHES", Path(__file__).parents[2] / "shared" / "meshes"))
        sys.argv += ["--mesh", str(folder / "bunny.obj")]
    sys.argv.insert(1, "bench")
    main()
