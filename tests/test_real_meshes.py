"""Every real mesh at hand, dirty ones included, is read, fitted for a few seconds and extracted."""

import re
import warnings

import numpy as np
import pytest

from levelflow import SIREN, Budget, Mesh, MeshWarning, Sampling, extract, fit
from levelflow.extraction import ExtractionWarning

EXPECTED = {
    "bar1.off": "point inward .* turned outward",
    "cylinder_small.off": "open",
    "plane-holes.obj": "open",
}
"""What is said of the meshes that are not in order; of the others nothing is said."""

NAMES = (
    "armadillo.obj", "bar1.off", "bob.obj", "bunny.obj", "cactus_highres.off", "cheburashka.off", "cylinder_small.off",
    "dino.off", "falcon.obj", "genus6.ply", "max-planck.obj", "plane-holes.obj", "rind_wide.ply", "spot.obj",
    "woman.obj",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_real_mesh_is_read_fitted_and_extracted_in_its_own_units(meshes, name):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        mesh = Mesh.read(meshes / name)
        field = fit(SIREN(width=64, omega=15), mesh, budget=Budget(steps=250), sampling=Sampling(n=2048, given=40_000))
        surface = extract(field, resolution=64)
    messages = [str(w.message) for w in said if issubclass(w.category, MeshWarning)]
    if name in EXPECTED:
        assert len(messages) == 1
        assert re.search(EXPECTED[name], messages[0])
    else:
        assert messages == []
    assert all(issubclass(w.category, MeshWarning | ExtractionWarning) for w in said)
    size = max(mesh.box.size)
    assert field.provenance["accuracy"]["mean"] < 0.01 * size
    assert np.allclose(surface.box.lower, mesh.box.lower, atol=0.06 * size)
    assert np.allclose(surface.box.upper, mesh.box.upper, atol=0.06 * size)
    if mesh.is_watertight:
        assert abs(surface.volume - mesh.volume) < 0.003 * size * mesh.area
