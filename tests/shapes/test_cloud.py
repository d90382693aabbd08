"""Point clouds: files, normals that are estimated and turned outward, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from levelflow.shapes import Circle, Cuboid, Mesh, PointCloud, Rectangle, Shape, Solid, Sphere, Torus, Translated


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def agreement(solid: Solid, n: int, **options: int) -> np.ndarray:
    points, normals = (part.numpy() for part in solid.sample(n, generator=generator()))
    return (PointCloud(points, **options).normals * normals).sum(1)


@pytest.mark.parametrize(
    ("solid", "right"),
    [(Sphere(), 1), (Torus(), 1), (Cuboid(), 0.99), (Cuboid((1, 1, 0.1)), 0.99), (Circle(), 1), (Rectangle(), 0.99)],
    ids=str,
)
def test_estimated_normals_point_outward(solid: Solid, right: float) -> None:
    cosines = agreement(solid, 3000)
    assert (cosines > 0).mean() >= right
    assert np.median(cosines) > 0.999


def test_estimated_normals_converge() -> None:
    errors = [np.sqrt((1 - agreement(Sphere(), n) ** 2).mean()) for n in (500, 2000, 8000)]
    assert errors[0] / errors[2] > 3
    assert errors[2] < 0.02


def test_each_body_is_turned_on_its_own() -> None:
    bodies = [Sphere(0.5), Translated(Torus(1, 0.3), (5, 0, 0))]
    points, normals = (
        torch.cat(parts).numpy()
        for parts in zip(*(body.sample(1500, generator=generator(i)) for i, body in enumerate(bodies)), strict=True)
    )
    assert ((PointCloud(points).normals * normals).sum(1) > 0).all()


def test_the_two_sides_of_a_thin_sheet_point_apart(meshes: Path) -> None:
    points, normals = Mesh.read(meshes / "rind_wide.ply").sample(20_000, generator=generator())
    assert ((PointCloud(points.numpy()).normals * normals.numpy()).sum(1) > 0).mean() > 0.98


def test_points_that_repeat_share_their_normal() -> None:
    points = Sphere().sample(300, generator=generator()).points.numpy()
    cloud = PointCloud(np.concatenate([points, points[:100], points[:1]]))
    assert len(cloud.points) == 401
    assert np.array_equal(cloud.normals[:100], cloud.normals[300:400])
    assert np.array_equal(cloud.normals[:300], PointCloud(points).normals)


def test_given_normals_are_kept_at_unit_length() -> None:
    points, normals = (part.numpy() for part in Sphere().sample(50, generator=generator()))
    assert np.allclose(PointCloud(points, -3 * normals).normals, -normals, atol=1e-15)


def test_a_cloud_is_a_shape_without_distance() -> None:
    cloud = PointCloud(Sphere().sample(50, generator=generator()).points.numpy(), name="ball.xyz")
    assert isinstance(cloud, Shape)
    assert not hasattr(cloud, "distance")
    assert repr(cloud) == "PointCloud('ball.xyz', 50 points)"
    assert cloud.box.lower == tuple(cloud.points.min(0))
    with pytest.raises(ValueError, match="read-only"):
        cloud.points[0] = 0


def test_samples_are_points_of_the_cloud() -> None:
    cloud = PointCloud(*(part.numpy() for part in Torus().sample(200, generator=generator())))
    rows = {tuple(row): i for i, row in enumerate(cloud.points.tolist())}
    assert np.array_equal(cloud.sample(200, generator=generator()).points.numpy(), cloud.points)
    for n in (50, 1000):
        points, normals = cloud.sample(n, generator=generator(1))
        chosen = [rows[tuple(row)] for row in points.tolist()]
        assert np.array_equal(normals.numpy(), cloud.normals[chosen])
        assert torch.equal(points, cloud.sample(n, generator=generator(1)).points)
        assert len(set(chosen)) == (50 if n == 50 else len(set(chosen)))
        assert len(set(chosen)) <= 200


def test_tables_are_read(tmp_path: Path) -> None:
    points, normals = (part.numpy() for part in Torus().sample(60, generator=generator()))
    table = np.concatenate([points, normals], 1)
    np.save(tmp_path / "a.npy", table)
    np.savetxt(tmp_path / "a.xyz", table)
    np.savetxt(tmp_path / "a.txt", table, header="x y z nx ny nz")
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="x,y,z,nx,ny,nz", comments="")
    for extension in ("npy", "xyz", "txt", "csv"):
        cloud = PointCloud.read(tmp_path / f"a.{extension}")
        assert np.allclose(cloud.points, points, atol=1e-15)
        assert np.allclose(cloud.normals, normals, atol=1e-15)
    np.savetxt(tmp_path / "b.csv", points, delimiter=" ; ")
    assert np.allclose(PointCloud.read(tmp_path / "b.csv").points, points, atol=1e-15)


def test_clouds_in_the_plane_are_read(tmp_path: Path) -> None:
    points, normals = (part.numpy() for part in Circle().sample(60, generator=generator()))
    np.savetxt(tmp_path / "a.txt", points)
    np.save(tmp_path / "a.npy", np.concatenate([points, normals], 1).astype(np.float32))
    assert PointCloud.read(tmp_path / "a.txt").box.space == 2
    assert np.allclose(PointCloud.read(tmp_path / "a.npy").normals, normals, atol=1e-6)


def test_ply_with_and_without_normals_and_obj_are_read(tmp_path: Path) -> None:
    points, normals = (part.numpy() for part in Torus().sample(300, generator=generator()))
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 300\n"
    names = "".join(f"property double {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    table = np.concatenate([points, normals], 1)
    (tmp_path / "a.ply").write_bytes((head + names + "end_header\n").encode() + table.tobytes())
    assert np.allclose(PointCloud.read(tmp_path / "a.ply").normals, normals, atol=1e-15)
    names = "".join(f"property double {name}\n" for name in ("x", "y", "z"))
    (tmp_path / "b.ply").write_bytes((head + names + "end_header\n").encode() + points.tobytes())
    (tmp_path / "b.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in points.tolist()))
    for name in ("b.ply", "b.obj"):
        cloud = PointCloud.read(tmp_path / name, neighbors=10)
        assert np.array_equal(cloud.points, points)
        assert ((cloud.normals * normals).sum(1) > 0).mean() > 0.95


line = np.linspace(0, 1, 40)[:, None] * np.array([[1.0, 2.0, 3.0]])
ball = Sphere().sample(40, generator=generator())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PointCloud(np.eye(3)), "PointCloud: 3 points do not make a surface; at least 10 in space"),
        (lambda: PointCloud(np.eye(2)), "at least 5 in the plane"),
        (lambda: PointCloud(np.zeros((0, 3))), "0 points do not make a surface"),
        (lambda: PointCloud(np.tile(np.eye(3), (9, 1))), "27 points, 3 of them different, do not make a surface"),
        (lambda: PointCloud(np.where(np.arange(40)[:, None] == 7, np.nan, line)), "1 of 40 points .* point 7"),
        (lambda: PointCloud(np.zeros((40, 4))), r"shape \(40, 4\); wanted is \(n, 3\)"),
        (lambda: PointCloud(line), "all 40 points lie on a line"),
        (lambda: PointCloud(ball.points.numpy(), neighbors=2), "neighbors=2 is too few"),
        (lambda: PointCloud(ball.points.numpy(), np.ones((3, 3))), r"the normals have the shape \(3, 3\)"),
        (lambda: PointCloud(ball.points.numpy(), np.zeros((40, 3))), "40 of 40 normals are zero"),
    ],
)
def test_bad_points_are_refused(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.xyz", "0 0 0\n1 0 0\n0 1 0\n", "a.xyz: 3 points do not make a surface"),
        ("b.xyz", "one two three\nfour five six\n", "'b.xyz' is not a valid XYZ file: row 1 reads 'four five six'"),
        ("c.csv", "x,y,z\n", "there are no numbers in it"),
        ("d.txt", "1 2 3 4 5\n", "its rows have 5 numbers; wanted are 3"),
        ("e.txt", "1 2 3\n1 2\n", "row 2 reads '1 2' where 3 numbers belong"),
        ("f.npy", "not an array", "'f.npy' is not a valid NPY file"),
        ("g.las", "1", "known are .ply, .obj, .xyz, .txt, .csv, .npy"),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, name: str, content: str, message: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(ValueError, match=message):
        PointCloud.read(tmp_path / name)


def test_arrays_of_another_shape_and_missing_files_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros(30))
    with pytest.raises(ValueError, match=r"of shape \(n, 3\) or \(n, 6\) is wanted, this one is \(30,\)"):
        PointCloud.read(tmp_path / "a.npy")
    with pytest.raises(FileNotFoundError, match="PointCloud.read: there is no file"):
        PointCloud.read(tmp_path / "b.npy")
