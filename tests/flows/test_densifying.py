"""What is between given vertices: harmonic, like a beam, or as rigid as possible, against exact solutions."""

from __future__ import annotations

import igl
import numpy as np
import pytest

from levelflow.boxes import Box
from levelflow.extraction import extract
from levelflow.flows.densifying import AsRigidAsPossible, BlendedMotions, Pull, ThinShell, arap, thin_shell, untouched
from levelflow.shapes import Cylinder, Mesh
from tests.shapes.test_distance import globe


def turned(x: np.ndarray, degrees: float) -> np.ndarray:
    """Turned about the last axis, or about the origin of the plane."""
    a = np.radians(degrees)
    out = x.copy()
    out[:, 0], out[:, 1] = np.cos(a) * x[:, 0] - np.sin(a) * x[:, 1], np.sin(a) * x[:, 0] + np.cos(a) * x[:, 1]
    return out


def tube(n: int = 32, m: int = 49, length: float = 6.0) -> Mesh:
    """A closed cylinder of radius 1 from z = 0 to its length, m rings of n vertices and two caps."""
    a, z = np.linspace(0, 2 * np.pi, n, endpoint=False), np.linspace(0, length, m)
    z, a = (grid.reshape(-1) for grid in np.meshgrid(z, a, indexing="ij"))
    points = np.concatenate([np.stack([np.cos(a), np.sin(a), z], 1), [[0, 0, 0], [0, 0, length]]])
    i, j = (grid.reshape(-1) for grid in np.meshgrid(np.arange(m - 1), np.arange(n), indexing="ij"))
    k = (j + 1) % n
    quads = np.stack([i * n + j, i * n + k, (i + 1) * n + k, (i + 1) * n + j], 1)
    j, k, last = np.arange(n), (np.arange(n) + 1) % n, (m - 1) * n
    caps = [np.stack([np.full(n, m * n), k, j], 1), np.stack([np.full(n, m * n + 1), last + j, last + k], 1)]
    return Mesh(points, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]], *caps]))


def strip(columns: int = 41, rows: int = 5) -> Mesh:
    """The rectangle from (0, 0) to (1, 0.1) in the plane z = 0."""
    x, y = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 0.1, rows), indexing="ij")
    points = np.stack([x.reshape(-1), y.reshape(-1), np.zeros(x.size)], 1)
    i, j = (grid.reshape(-1) for grid in np.meshgrid(np.arange(columns - 1), np.arange(rows - 1), indexing="ij"))
    corner = i * rows + j
    quads = np.stack([corner, corner + rows, corner + rows + 1, corner + 1], 1)
    return Mesh(points, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]))


def bar() -> Mesh:
    """A slender box around the x axis, all sides cut into squares with diagonals."""
    box = Box((-1, -0.2, -0.2), (1, 0.2, 0.2))
    x, y, z = (np.linspace(a, b, round((b - a) / 0.1) + 1) for a, b in zip(box.lower, box.upper, strict=True))
    points: list[np.ndarray] = []
    faces: list[np.ndarray] = []
    for normal, (u, v) in enumerate(((y, z), (z, x), (x, y))):
        for side in (0, 1):
            n, m = len(u), len(v)
            sheet = np.empty((n * m, 3))
            sheet[:, (normal + 1) % 3], sheet[:, (normal + 2) % 3] = (
                g.reshape(-1) for g in np.meshgrid(u, v, indexing="ij")
            )
            sheet[:, normal] = (box.lower, box.upper)[side][normal]
            i, j = (grid.reshape(-1) for grid in np.meshgrid(np.arange(n - 1), np.arange(m - 1), indexing="ij"))
            quads = np.stack([i * m + j, (i + 1) * m + j, (i + 1) * m + j + 1, i * m + j + 1], 1)
            triangles = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
            faces.append((triangles if side else triangles[:, ::-1]) + sum(map(len, points)))
            points.append(sheet)
    place, number = np.unique(np.concatenate(points).round(9) + 0.0, axis=0, return_inverse=True)
    return Mesh(place, number.reshape(-1)[np.concatenate(faces)])


def ring(n: int = 60) -> Mesh:
    a = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return Mesh(np.stack([2 * np.cos(a), np.sin(a)], 1), np.stack([np.arange(n), np.roll(np.arange(n), -1)], 1))


def ends(mesh: Mesh, axis: int, share: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """The vertices at both ends along an axis."""
    x = (mesh.vertices[:, axis] - mesh.box.lower[axis]) / mesh.box.size[axis]
    return np.flatnonzero(x <= share + 1e-9), np.flatnonzero(x >= 1 - share - 1e-9)


COEFFICIENTS = [(1.0, 0.0), (0.0, 1.0), (1.0, 0.1)]
MESHES = {"tube": tube(), "ring": ring(), "globe": globe(16)}
DENSIFIERS = [ThinShell(), ThinShell(stretch=1.0, bend=0.3), BlendedMotions(), AsRigidAsPossible()]


@pytest.mark.parametrize(("stretch", "bend"), COEFFICIENTS)
@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_what_is_given_is_met_and_constants_are_reproduced(mesh: Mesh, stretch: float, bend: float) -> None:
    fixed = np.concatenate(ends(mesh, 1))
    values = np.random.default_rng(0).normal(size=(len(fixed), 2))
    found = thin_shell(mesh, fixed, values, stretch=stretch, bend=bend)
    assert np.abs(found[fixed] - values).max() == 0
    assert np.abs(thin_shell(mesh, fixed, 0 * values + [3, -1], stretch=stretch, bend=bend) - [3, -1]).max() < 1e-9


@pytest.mark.parametrize(("stretch", "bend"), COEFFICIENTS)
def test_linear_functions_are_reproduced_on_a_flat_mesh(stretch: float, bend: float) -> None:
    """An uneven triangulation of a square, given on its outermost vertices and those next to them."""
    mesh = strip(21, 21)
    x = mesh.vertices * [1, 10, 0]
    inner = ((x[:, :2] > 0.08) & (x[:, :2] < 0.92)).all(1)
    x[inner, :2] += np.random.default_rng(0).uniform(-0.015, 0.015, (int(inner.sum()), 2))
    linear = x @ [[1.0, -2], [3, 0.5], [0, 0]] + [1, 2]
    fixed = np.flatnonzero(~inner)
    found = thin_shell(Mesh(x, mesh.faces), fixed, linear[fixed], stretch=stretch, bend=bend)
    assert np.abs(found - linear).max() < 1e-10


def test_bending_alone_is_the_cubic_beam() -> None:
    """Clamped at one end, lifted and kept level at the other: u = 3 s^2 - 2 s^3 between the clamps."""
    mesh = strip()
    x = mesh.vertices[:, 0]
    left, right = np.flatnonzero(x < 0.03), np.flatnonzero(x > 0.97)
    clamped = np.concatenate([left, right])
    exact = lambda x: 3 * x**2 - 2 * x**3  # noqa: E731
    found = thin_shell(mesh, clamped, exact(x[clamped])[:, None], stretch=0.0, bend=1.0)
    # The fourth difference of a cubic is zero: no error of discretisation.
    assert np.abs(found[:, 0] - exact(x)).max() < 1e-9


def test_stretching_and_bending_are_a_beam_under_tension() -> None:
    """u'''' = u'' / l^2 has the solutions 1, x, cosh(x / l), sinh(x / l); second order in the spacing."""
    errors = []
    for columns in (41, 81):
        mesh = strip(columns)
        x, h = mesh.vertices[:, 0], 1.01 / (columns - 1)
        exact = np.sinh(x / 0.2) / np.sinh(5) + 0.5 * x
        fixed = np.flatnonzero((x < h) | (x > 1 - h))
        found = thin_shell(mesh, fixed, exact[fixed, None], stretch=1.0, bend=0.04)[:, 0]
        errors.append(np.abs(found - exact).max())
    assert errors[0] < 1e-3
    assert errors[1] < errors[0] / 3.5


def test_stretching_alone_is_harmonic() -> None:
    """On the unit sphere between two circles of latitude, log tan(polar / 2) is harmonic; and there are no extremes."""
    errors = []
    for n in (16, 32):
        mesh = globe(n)
        z = mesh.vertices[:, 2]
        exact = np.log(np.tan(np.arccos(np.clip(z, -0.999, 0.999)) / 2))
        fixed = np.flatnonzero(np.abs(z) > 0.9)
        found = thin_shell(mesh, fixed, exact[fixed, None], stretch=1.0, bend=0.0)[:, 0]
        assert exact[fixed].min() <= found.min() and found.max() <= exact[fixed].max()
        errors.append(np.abs(found - exact).max())
    assert errors[1] < errors[0] / 3
    assert errors[1] < 0.005


def test_on_a_curve_stretching_is_linear_in_the_length() -> None:
    mesh = ring()
    length = np.cumsum([0.0, *mesh.face_areas])[:-1]
    fixed = np.array([0, 40])
    found = thin_shell(mesh, fixed, np.array([[0.0], [length[40]]]), stretch=1.0, bend=0.0)[:, 0]
    assert found[:41] == pytest.approx(length[:41], abs=1e-10)


@pytest.mark.parametrize("densify", DENSIFIERS, ids=repr)
@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_a_translation_of_all_is_reproduced(mesh: Mesh, densify) -> None:
    by = np.arange(1.0, mesh.vertices.shape[1] + 1)
    pulls = [Pull(end, lambda x: x + by) for end in ends(mesh, 0)]
    assert np.abs(densify(mesh, pulls) - by).max() < 1e-9


@pytest.mark.parametrize("densify", [BlendedMotions(), BlendedMotions(1.0, 0.1), AsRigidAsPossible()], ids=repr)
@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_a_rotation_of_all_is_reproduced(mesh: Mesh, densify) -> None:
    pulls = [Pull(end, lambda x: turned(x, 120)) for end in ends(mesh, 0)]
    assert np.abs(mesh.vertices + densify(mesh, pulls) - turned(mesh.vertices, 120)).max() < 1e-9


def test_as_rigid_as_possible_finds_a_rotation_from_afar() -> None:
    mesh = tube()
    fixed = np.concatenate(ends(mesh, 2))
    exact = turned(mesh.vertices, 90)
    found = arap(mesh, fixed, exact[fixed], iterations=300)
    assert np.abs(found - exact).max() < 1e-4
    # Displacements know of no rotation: the middle of the tube stays behind.
    shell = mesh.vertices + thin_shell(mesh, fixed, (exact - mesh.vertices)[fixed])
    assert np.abs(shell - exact).max() > 0.5


def test_as_rigid_as_possible_agrees_with_another_implementation() -> None:
    mesh = bar()
    left, right = ends(mesh, 0)
    fixed = np.concatenate([left, right])
    positions = mesh.vertices[fixed]
    positions[len(left) :] = positions[len(left) :] @ np.array([[0.5, 0, 0.75**0.5], [0, 1, 0], [-(0.75**0.5), 0, 0.5]])
    start = mesh.vertices + thin_shell(mesh, fixed, positions - mesh.vertices[fixed])
    data = igl.ARAPData()
    data.max_iter = 30
    igl.arap_precomputation(mesh.vertices.copy(), mesh.faces.copy(), 3, fixed.astype(np.int32), data)
    # It turns in single precision.
    expected = igl.arap_solve(positions, data, start)
    assert np.abs(arap(mesh, fixed, positions, iterations=30) - expected).max() < 1e-4


def bent(mesh: Mesh, degrees: float) -> list[Pull]:
    """The left end of a bar held, the right one turned upwards and carried along a circular arc."""
    left, right = ends(mesh, 0)
    a, r = np.radians(degrees), 1.8 / np.radians(degrees)

    def up(x: np.ndarray) -> np.ndarray:
        out = turned(x - [0.8, 0, 0], degrees) + [-0.8 + r * np.sin(a), r * (1 - np.cos(a)), 0]
        out[:, 2] = x[:, 2]
        return out

    return [Pull(left, lambda x: x), Pull(right, up)]


def edge_change(mesh: Mesh, move: np.ndarray) -> float:
    i, j = mesh.faces[:, 0], mesh.faces[:, 1]
    x = mesh.vertices
    before, after = np.linalg.norm(x[i] - x[j], axis=1), np.linalg.norm((x + move)[i] - (x + move)[j], axis=1)
    return float(np.abs(np.log(after / before)).mean())


def test_as_rigid_as_possible_bends_a_bar_with_less_distortion() -> None:
    mesh = bar()
    pulls = bent(mesh, 90)
    shell, blended, rigid = (
        edge_change(mesh, f(mesh, pulls)) for f in (ThinShell(), BlendedMotions(), AsRigidAsPossible())
    )
    # Bending alone makes the outer side longer and the inner one shorter, by a sixth.
    assert rigid < 0.75 * shell < 0.75 * blended


def slivers(mesh: Mesh) -> Mesh:
    """Every tenth edge with almost no length, or with none."""
    x = np.array(mesh.vertices)
    for number, face in enumerate(mesh.faces[::20]):
        x[face[1]] = x[face[0]] + (0.0, 1e-13, 1e-9, 1e-5)[number % 4] * (x[face[1]] - x[face[0]])
    return Mesh(x, mesh.faces)


@pytest.mark.parametrize(("stretch", "bend"), COEFFICIENTS)
def test_faces_without_area_do_no_harm(stretch: float, bend: float) -> None:
    """The weights of a motion hardly change, and stay continuous across what has collapsed."""
    plain, broken = tube(), slivers(tube())
    fixed = np.concatenate(ends(plain, 2))
    values = (plain.vertices[fixed, 2:] > 3) * 1.0
    good, bad = (thin_shell(mesh, fixed, values, stretch=stretch, bend=bend)[:, 0] for mesh in (plain, broken))
    assert np.abs(bad - good).max() < 0.1
    short = np.linalg.norm(np.diff(broken.vertices[broken.faces[:, :2]], axis=1)[:, 0], axis=1) < 1e-6
    assert np.abs(np.diff(bad[broken.faces[short, :2]], axis=1)).max() < 1e-3
    assert np.isfinite(AsRigidAsPossible(20)(broken, [Pull(fixed, lambda x: turned(x, 30))])).all()


def test_meshes_of_marching_cubes_are_no_worse_than_others() -> None:
    mesh = extract(
        Cylinder(0.3, 1.0001).distance, box=Box((-0.6, -0.6, -0.6), (0.6, 0.6, 0.6)), resolution=24, refine=3
    )
    assert mesh.face_areas.min() < 1e-4 * mesh.face_areas.mean()
    fixed = np.concatenate(ends(mesh, 2))
    exact = turned(mesh.vertices, 30)
    pulls = [Pull(fixed, lambda x: turned(x, 30))]
    for densify in (BlendedMotions(), AsRigidAsPossible()):
        assert np.abs(mesh.vertices + densify(mesh, pulls) - exact).max() < 1e-8


@pytest.mark.parametrize("densify", DENSIFIERS, ids=repr)
def test_bodies_without_a_given_vertex_stay(densify) -> None:
    one = globe(8)
    n = len(one.vertices)
    mesh = Mesh(
        np.concatenate([one.vertices, one.vertices + [5, 0, 0], [[9, 9, 9]]]),
        np.concatenate([one.faces, one.faces + n]),
    )
    pulls = [Pull(np.array([0, 3, 40]), lambda x: turned(x, 40) + [0, 0, 1])]
    move = densify(mesh, pulls)
    assert not move[n:].any()
    assert untouched(mesh, pulls[0].vertices).tolist() == [False] * n + [True] * (n + 1)
    assert np.abs(move[:n]).min(0).max() > 0


@pytest.mark.parametrize("densify", DENSIFIERS, ids=repr)
def test_where_all_vertices_are_given_nothing_is_left_to_do(densify) -> None:
    mesh = globe(8)
    move = densify(mesh, [Pull(np.arange(len(mesh.vertices)), lambda x: turned(x, 40))])
    assert np.abs(mesh.vertices + move - turned(mesh.vertices, 40)).max() < 1e-14


@pytest.mark.parametrize("solve", [thin_shell, arap], ids=["thin_shell", "arap"])
@pytest.mark.parametrize(
    ("fixed", "values", "message"),
    [
        ([], np.zeros((0, 3)), "no vertex is given, so every constant would do; fix at least one"),
        ([0, 0], np.zeros((2, 3)), "must be different numbers from 0 to 481"),
        ([-1, 0], np.zeros((2, 3)), "must be different numbers"),
        ([0, 482], np.zeros((2, 3)), "must be different numbers"),
        ([0, 7], np.array([[0, 0, 0], [0, np.nan, 0]]), r"at vertex 7 is not finite: \[0.0, nan, 0.0\]"),
    ],
)
def test_vertices_that_cannot_be_given_are_refused(solve, fixed: list, values: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{solve.__name__}: .*{message}"):
        solve(globe(16), np.array(fixed, dtype=np.int64), values)


@pytest.mark.usefixtures("unchecked")
def test_what_does_not_fit_is_refused() -> None:
    mesh, fixed = globe(16), np.array([0, 1])
    with pytest.raises(ValueError, match=r"thin_shell: 2 vertices are given and values of the shape \(3, 3\)"):
        thin_shell(mesh, fixed, np.zeros((3, 3)))
    with pytest.raises(ValueError, match=r"arap: 2 vertices are given and values of the shape \(2, 2\); .* \(2, 3\)"):
        arap(mesh, fixed, np.zeros((2, 2)))
    with pytest.raises(ValueError, match=r"arap: the start has the shape \(5, 3\); the mesh has 482 vertices"):
        arap(mesh, fixed, np.zeros((2, 3)), start=np.zeros((5, 3)))


def test_coefficients_and_iterations_that_cannot_be_are_refused() -> None:
    mesh, fixed = globe(16), np.array([0, 1])
    for stretch, bend in ((-1.0, 1.0), (1.0, -1.0), (0.0, 0.0), (np.nan, 1.0), (np.inf, 1.0)):
        with pytest.raises(
            ValueError, match=r"thin_shell\(stretch=.*, bend=.*\): the coefficients must not be negative"
        ):
            thin_shell(mesh, fixed, np.zeros((2, 1)), stretch=stretch, bend=bend)
    for densifier in (ThinShell, BlendedMotions):
        with pytest.raises(ValueError, match=rf"{densifier.__name__}\(stretch=-1, bend=1\)"):
            densifier(stretch=-1.0)
    with pytest.raises(ValueError, match=r"arap\(iterations=0\): at least one iteration"):
        arap(mesh, fixed, np.zeros((2, 3)), iterations=0)
    with pytest.raises(ValueError, match=r"`AsRigidAsPossible\(iterations=0\)`: at least one iteration"):
        AsRigidAsPossible(0)
