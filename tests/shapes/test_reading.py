"""Files of meshes: what is read, what is cleaned, what is refused, and what is written."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import pytest
import torch

from levelflow.shapes import Mesh, MeshWarning, simplices
from tests.shapes.test_distance import CUBE_CORNERS, CUBE_FACES, CUBE_QUADS, cube, globe


def obj(vertices: np.ndarray, polygons, *, form: str = "{}") -> str:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices.tolist()]
    return "\n".join(lines + ["f " + " ".join(form.format(i + 1, k + 1) for k, i in enumerate(p)) for p in polygons])


def written(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def is_a_cube(mesh: Mesh, volume: float = 1.0) -> bool:
    return (
        mesh.is_watertight
        and len(mesh.vertices) == 8
        and len(mesh.faces) == 12
        and bool(np.isclose(mesh.volume, volume))
    )


@pytest.mark.parametrize("form", ["{}", "{}/{}", "{}//{}", "{}/1/{}"])
def test_obj_with_texture_and_normals(tmp_path: Path, form: str) -> None:
    text = "# a cube\nmtllib a.mtl\no cube\nvt 0 0\nvn 0 0 1\n" + obj(CUBE_CORNERS, CUBE_QUADS, form=form)
    assert is_a_cube(Mesh.read(written(tmp_path, "cube.OBJ", text)))


def test_obj_with_negative_numbers_continued_lines_and_colours(tmp_path: Path) -> None:
    vertices = "\n".join(f"v {x} {y} {z} 1 0 0" for x, y, z in CUBE_CORNERS)
    faces = "\n".join(
        "f " + " ".join(str(i - 8) for i in quad[:2]) + " \\\n" + f"{quad[2] - 8} {quad[3] - 8}" for quad in CUBE_QUADS
    )
    assert is_a_cube(Mesh.read(written(tmp_path, "cube.obj", vertices + "\n" + faces)))


def test_seams_are_closed(tmp_path: Path) -> None:
    """Each square of the cube has its own four vertices, as exporters with texture seams write it."""
    soup = CUBE_CORNERS[CUBE_QUADS].reshape(-1, 3)
    mesh = Mesh.read(written(tmp_path, "seams.obj", obj(soup, np.arange(24).reshape(6, 4))))
    assert is_a_cube(mesh)
    # -0.0 and 0.0 are one place.
    soup = soup - 0.5
    soup[:12][soup[:12] == 0] = -0.0
    assert is_a_cube(Mesh.read(written(tmp_path, "zeros.obj", obj(soup, np.arange(24).reshape(6, 4)))))


def test_closed_bodies_that_touch_stay_apart(tmp_path: Path) -> None:
    corners = np.concatenate([CUBE_CORNERS, CUBE_CORNERS + [1, 1, 0]])
    quads = np.concatenate([CUBE_QUADS, CUBE_QUADS + 8])
    mesh = Mesh.read(written(tmp_path, "touching.obj", obj(corners, quads)))
    assert mesh.components == 2
    assert mesh.is_watertight


def test_degenerate_faces_and_unused_vertices_are_left_out(tmp_path: Path) -> None:
    corners = np.concatenate([[[9, 9, 9]], CUBE_CORNERS])
    polygons = [*(CUBE_QUADS + 1).tolist(), [1, 2, 1], [3, 3, 3], [4, 5]]
    assert is_a_cube(Mesh.read(written(tmp_path, "dirty.obj", obj(corners, polygons))))


def test_polygons_are_triangulated_whatever_their_form(tmp_path: Path) -> None:
    """A prism over a star with nine concave corners, and over a bent quad; volume is area times height."""
    a = np.linspace(0, 2 * np.pi, 18, endpoint=False)
    star = np.stack([np.cos(a), np.sin(a)], 1) * np.where(np.arange(18) % 2, 0.3, 1.0)[:, None]
    dart = np.array([[0.2, 0.0], [-1.0, 1.0], [1.0, 0.0], [-1.0, -1.0]])[::-1]
    for flat in (star, dart):
        n = len(flat)
        after = np.roll(flat, -1, axis=0)
        area = (flat[:, 0] * after[:, 1] - flat[:, 1] * after[:, 0]).sum() / 2
        corners = np.concatenate([np.insert(flat, 2, 0, axis=1), np.insert(flat, 2, 1, axis=1)])
        sides = [[i, (i + 1) % n, n + (i + 1) % n, n + i] for i in range(n)]
        mesh = Mesh.read(
            written(tmp_path, "prism.obj", obj(corners, [list(range(n))[::-1], list(range(n, 2 * n)), *sides]))
        )
        length = np.linalg.norm(after - flat, axis=1).sum()
        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(area)
        assert mesh.area == pytest.approx(2 * area + length)
        assert len(mesh.faces) == 2 * (n - 2) + 2 * n


def test_triangles_stay_in_the_order_of_their_polygons() -> None:
    corners = np.array([0, 1, 2, 0, 2, 4, 3, 1, 5, 7])
    triangles = simplices.triangulated(CUBE_CORNERS, corners, np.array([3, 4, 3]))
    assert len(triangles) == 4
    assert triangles[0].tolist() == [0, 1, 2]
    assert triangles[-1].tolist() == [1, 5, 7]


def test_inside_out_files_are_turned_with_a_warning(tmp_path: Path) -> None:
    path = written(tmp_path, "in.obj", obj(CUBE_CORNERS, CUBE_QUADS[:, ::-1]))
    with pytest.warns(MeshWarning, match=r"^in.obj: the faces point inward \(volume -1\); turned outward\.$"):
        assert is_a_cube(Mesh.read(path))
    both = np.concatenate([CUBE_CORNERS * 3, CUBE_CORNERS + 4]), np.concatenate([CUBE_QUADS, CUBE_QUADS[:, ::-1] + 8])
    with pytest.warns(MeshWarning, match="two.obj: 12 of 24 faces point inward"):
        assert Mesh.read(written(tmp_path, "two.obj", obj(*both))).volume == pytest.approx(28)


@pytest.mark.parametrize("head", ["OFF\n# note\n8 6 0\n", "OFF 8 6 12\n", "COFF\n8 6 0\n\n"])
def test_off(tmp_path: Path, head: str) -> None:
    tail = " 255 0 0 255" if head.startswith("C") else ""
    rows = [f"{x} {y} {z}{tail}" for x, y, z in CUBE_CORNERS]
    rows += ["4 " + " ".join(map(str, quad)) + " 255 0 0" for quad in CUBE_QUADS]
    assert is_a_cube(Mesh.read(written(tmp_path, "cube.off", head + "\n".join(rows))))


PLY_HEAD = (
    "ply\nformat {} 1.0\ncomment made here\nelement material 1\nproperty list uchar float shades\nelement vertex 8\n"
    "property double x\nproperty uchar red\nproperty double y\nproperty double z\nelement face 7\n"
    "property list uchar int vertex_index\nproperty list uchar float texcoord\nelement extra 1\nproperty int a\n"
    "end_header\n"
)
MIXED = [*CUBE_QUADS[:5].tolist(), CUBE_QUADS[5, :3].tolist(), CUBE_QUADS[5, [0, 2, 3]].tolist()]


def test_ply_text_with_other_elements_and_mixed_polygons(tmp_path: Path) -> None:
    rows = ["2 0.5 0.5", *(f"{x} 7 {y} {z}" for x, y, z in CUBE_CORNERS)]
    rows += [f"{len(p)} {' '.join(map(str, p))} 2 0 0" for p in MIXED]
    assert is_a_cube(Mesh.read(written(tmp_path, "cube.ply", PLY_HEAD.format("ascii") + "\n".join(rows) + "\n9\n")))


@pytest.mark.parametrize("order", ["<", ">"])
def test_ply_binary_with_other_elements_and_mixed_polygons(tmp_path: Path, order: str) -> None:
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    data = struct.pack(order + "B2f", 2, 0.5, 0.5)
    data += b"".join(struct.pack(order + "dBdd", x, 7, y, z) for x, y, z in CUBE_CORNERS)
    data += b"".join(struct.pack(f"{order}B{len(p)}iB2f", len(p), *p, 2, 0, 0) for p in MIXED)
    path = written(tmp_path, "cube.ply", PLY_HEAD.format(name).encode() + data + struct.pack(order + "i", 9))
    assert is_a_cube(Mesh.read(path))


def test_stl_text_and_binary(tmp_path: Path) -> None:
    corners = CUBE_CORNERS[CUBE_FACES]
    facets = "".join(
        "facet normal 0 0 0\n outer loop\n"
        + "".join(f"  vertex {x} {y} {z}\n" for x, y, z in t)
        + " endloop\nendfacet\n"
        for t in corners
    )
    assert is_a_cube(Mesh.read(written(tmp_path, "text.stl", f"solid cube\n{facets}endsolid cube\n")))
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *t.reshape(-1), 0) for t in corners)
    # Some exporters begin binary files with the word of the text format.
    assert is_a_cube(Mesh.read(written(tmp_path, "b.stl", b"solid".ljust(80) + struct.pack("<I", 12) + body)))


@pytest.mark.parametrize("extension", [".glb", ".gltf"])
def test_gltf_with_two_bodies_moved_and_mirrored(tmp_path: Path, extension: str) -> None:
    trimesh = pytest.importorskip("trimesh")
    scene = trimesh.Scene()
    body = trimesh.Trimesh(CUBE_CORNERS, CUBE_FACES, process=False)
    move = np.diag([2.0, 1.0, 1.0, 1.0])
    move[:3, 3] = (5, 0, 0)
    scene.add_geometry(body, node_name="one", geom_name="cube")
    scene.graph.update(frame_to="two", matrix=move, geometry="cube")
    scene.graph.update(frame_to="three", matrix=np.diag([-1.0, 3.0, 1.0, 1.0]) + np.eye(4, k=3) * -5, geometry="cube")
    path = tmp_path / f"scene{extension}"
    exported = scene.export(file_type=extension[1:])
    if extension == ".glb":
        path.write_bytes(exported)
    else:
        for name, data in exported.items():
            (tmp_path / ("scene.gltf" if name.endswith(".gltf") else name)).write_bytes(data)
    mesh = Mesh.read(path)
    assert mesh.components == 3
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(1 + 2 + 3)
    assert mesh.box.lower == pytest.approx((-5.5, -1.5, -0.5))
    assert mesh.box.upper == pytest.approx((6, 1.5, 0.5))


BAD = {
    "words.obj": ("Dear reader,\nthis is a letter.\n", "'words.obj' is not a valid OBJ file: no line starts with 'v'"),
    "vague.obj": ("very nice\nv 1 2 x\n", "'vague.obj' .* vertex 1 reads '1 2 x' where 3 numbers belong"),
    "thin.obj": ("v 1 2\nv 1 2 3\n", "vertex 2 reads '1 2 3' where 2 numbers belong"),
    "one.obj": ("v 1\nv 2\n", "fewer than two coordinates"),
    "plane.obj": ("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "In the plane a mesh is made of segments"),
    "inf.obj": ("v 0 0 0\nv 1 0 0\nv inf 1 0\nv 0 1 0\nf 1 2 3 4\n", "inf.obj: 1 of 4 vertices have NaN or inf"),
    "short.obj": ("v 1 2 3\nv 1 2\n", "vertex 2 reads '1 2' where 3 numbers belong"),
    "names.obj": ("v 1 2 3\nf one two three\n", "line 2 reads 'f one two three', which names no vertices"),
    "binary.obj": (b"\x00\x01\x02\xff" * 9, "it holds binary data, not text"),
    "empty.obj": ("", "'empty.obj' is empty"),
    "points.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "3 points and no faces; read it with `PointCloud.read`"),
    "nan.obj": ("v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n", "nan.obj: 1 of 3 vertices have NaN"),
    "range.obj": (
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\n",
        "face 2 of 'range.obj' names vertex 9, and there are 3",
    ),
    "before.obj": ("v 0 0 0\nv 1 0 0\nf -1 -2 -3\n", "names vertex 0, and there are 2"),
    "flat.obj": ("v 0 0 0\nv 1 0 0\nf 1 2 1\nf 1 1 1\n", "none of the 2 faces of 'flat.obj' has three different"),
    "plain.off": ("8 6 0\n", "the first line does not say OFF"),
    "four.off": ("4OFF\n8 6 0\n", "four coordinates"),
    "bare.off": ("OFF\nmany\n", "the numbers of vertices and faces are missing"),
    "cut.off": ("OFF\n3 1 0\n0 0 0\n1 0 0\n", "announces 3 vertices and 1 faces and has 2 lines"),
    "odd.off": ("OFF\n1 1 0\n0 0 0\n3 a b c\n", "something that is not a number"),
    "none.off": ("OFF\n0 0 0\n", "'none.off' is empty, it has no vertices"),
    "head.ply": ("plywood", "no header from 'ply'"),
    "form.ply": ("ply\nformat morse 1.0\nend_header\n", "its format 'morse' is not known"),
    "odd.ply": ("ply\nformat ascii 1.0\nelement vertex many\nend_header\n", "has the line 'element vertex many'"),
    "flat.ply": (
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
        "names no vertices with x",
    ),
    "cut.ply": (
        "ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\nproperty float y\nend_header\nabc",
        "it ends, or goes wrong, within the 9 records of 'vertex'",
    ),
    "cut2.ply": (
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty int x\nproperty int y\nproperty int z\nelement face 2\n"
        + "property list uchar int vertex_indices\nend_header\n0 0 0 1 1 1\n3 0 1 1\n3 0",
        "within the 2 records of 'face'",
    ),
    "cut.stl": (b"part".ljust(80) + struct.pack("<I", 12) + b"abc", "announces 12 triangles, 684 bytes, and has 87"),
    "cut2.stl": ("solid a\nvertex 0 0 0\nvertex 1 0 0\n", "2 corners, not three per triangle"),
    "none.stl": ("solid a\nendsolid a\n", "'none.stl' is empty"),
    "junk.glb": (b"\x00\x01\x02\xff" * 9, "'junk.glb' is not a valid GLB file: the loader says"),
    "scan.xyz": ("0 0 0\n", r"the extension '.xyz'; known are .obj, .ply, .stl, .off, .glb, .gltf"),
    "none": ("0 0 0\n", "the extension ''; known are"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused(tmp_path: Path, name: str) -> None:
    content, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        Mesh.read(written(tmp_path, name, content))


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"Mesh.read: there is no file '.*nothing.obj' \(looked in "):
        Mesh.read(tmp_path / "nothing.obj")
    with pytest.raises(ValueError, match="is a folder"):
        Mesh.read(tmp_path)


@pytest.mark.parametrize("extension", [".ply", ".obj", ".off", ".stl"])
def test_what_is_written_is_read_again(tmp_path: Path, extension: str) -> None:
    mesh = globe(12)
    mesh.write(tmp_path / f"globe{extension}")
    again = Mesh.read(tmp_path / f"globe{extension}")
    assert again.is_watertight
    assert len(again.vertices) == len(mesh.vertices)
    corners = again.vertices[again.faces], mesh.vertices[mesh.faces]
    assert np.abs(corners[0] - corners[1]).max() < (1e-7 if extension in (".ply", ".stl") else 1e-16)
    assert os.listdir(tmp_path) == [f"globe{extension}"]


@pytest.mark.parametrize("extension", [".ply", ".obj"])
def test_curves_are_written_and_read_again(tmp_path: Path, extension: str) -> None:
    curve = Mesh(np.array([[0, 0], [2, 0], [2, 1], [0, 1]]), np.array([[0, 1], [1, 2], [2, 3], [3, 0]]))
    curve.write(tmp_path / f"curve{extension}")
    again = Mesh.read(tmp_path / f"curve{extension}")
    assert np.array_equal(again.vertices, curve.vertices)
    assert np.array_equal(again.faces, curve.faces)


def test_ply_and_obj_carry_normals(tmp_path: Path) -> None:
    mesh = Mesh(CUBE_CORNERS, CUBE_FACES, normals=CUBE_CORNERS * 2 / np.sqrt(3))
    mesh.write(tmp_path / "cube.ply")
    normals = Mesh.read(tmp_path / "cube.ply").normals
    assert normals is not None
    assert np.allclose(normals, mesh.normals, atol=1e-7)
    mesh.write(tmp_path / "cube.obj")
    text = (tmp_path / "cube.obj").read_text()
    assert text.count("vn ") == 8
    assert "f 1//1 2//2 4//4" in text
    assert is_a_cube(Mesh.read(tmp_path / "cube.obj"))
    assert cube().normals is None


def test_a_normalised_mesh_is_written_in_the_units_of_its_file(tmp_path: Path) -> None:
    path = written(tmp_path, "far.obj", obj(CUBE_CORNERS * 8 + [4e6, 0, 0], CUBE_QUADS))
    mesh = Mesh.read(path)
    for extension in (".ply", ".obj", ".off"):
        mesh.normalized(0.1).write(tmp_path / f"back{extension}")
        assert np.abs(Mesh.read(tmp_path / f"back{extension}").vertices - mesh.vertices).max() < 1e-8
    assert b"property double x" in (tmp_path / "back.ply").read_bytes()
    cube().write(tmp_path / "near.ply")
    assert b"property float x" in (tmp_path / "near.ply").read_bytes()


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, "cube.ply", "precious")

    def fail(*_: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="no space"):
        cube().write(path)
    assert path.read_text() == "precious"
    assert os.listdir(tmp_path) == ["cube.ply"]


def test_files_get_the_usual_permissions(tmp_path: Path) -> None:
    cube().write(tmp_path / "cube.ply")
    usual = written(tmp_path, "usual", "").stat().st_mode
    assert (tmp_path / "cube.ply").stat().st_mode == usual


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"cannot write 'cube.xyz'; known extensions are .ply, .obj, .off, .stl"):
        cube().write(tmp_path / "cube.xyz")
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        cube().write(tmp_path / "none" / "cube.ply")
    curve = Mesh(np.array([[0, 0], [1, 0], [0, 1]]), np.array([[0, 1], [1, 2], [2, 0]]))
    with pytest.raises(ValueError, match="STL holds no curves"):
        curve.write(tmp_path / "curve.stl")


def test_the_sign_survives_the_way_through_a_file(tmp_path: Path) -> None:
    cube((1, 2, 3)).write(tmp_path / "cube.stl")
    x = torch.tensor([[0.0, 0, 0], [0, 0, 2]])
    assert Mesh.read(tmp_path / "cube.stl").distance(x).tolist() == pytest.approx([-0.5, 0.5])
