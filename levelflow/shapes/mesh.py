"""Triangle meshes (polygons in the plane): read, cleaned, measured, sampled, and with exact signed distance."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import ClassVar, NamedTuple, final

import numpy as np
import torch
from jaxtyping import Float, Int, Real
from numpy.typing import ArrayLike
from torch import Tensor

from levelflow.boxes import Box, Frame
from levelflow.shapes import simplices
from levelflow.shapes.distance import Closest, TriangleDistance
from levelflow.shapes.reading import read_contents
from levelflow.shapes.shape import Samples, Solid
from levelflow.shapes.writing import write_contents


class MeshWarning(UserWarning):
    """A mesh was accepted although something about it is not as it should be."""


class SignUncertainty(NamedTuple):
    """Where it is unclear what is inside of a mesh.

    Space counts as uncertain where the winding number is further than 1/4 from both 0 (outside) and 1 (inside):
    near the holes of an open surface, where bodies overlap (2 and more), and inside a body that faces inward.

    Attributes:
        open_edges: How many edges (end points in the plane) have no neighbour that runs the other way.
        share: The share of the volume of the box, 5 % larger than the mesh, that is uncertain.
        surface_share: The share of the area from which a step of 1e-4 of the size to a side leads to such a place.
        region: The box around the uncertain points found, in the units of the file; None if there are none.
    """

    open_edges: int
    share: float
    surface_share: float
    region: Box | None


@final
@dataclass(frozen=True, eq=False, repr=False, init=False)
class Mesh(Solid):
    """A surface made of triangles in space, or a curve made of segments in the plane.

    Faces run counter-clockwise seen from outside; in the plane the solid lies to the left of its segments. The
    arrays are copies and read-only.

    Args:
        vertices: Positions, (n, d) with d = 2 or 3.
        faces: Vertex numbers of the triangles (d = 3) or segments (d = 2), (m, d).
        normals: Unit normals at the vertices where something better than the mean of the faces is known.
        frame: How the vertices lie in the units of the file, if they were normalised.
        name: What messages call the mesh.

    Raises:
        ValueError: If there are no vertices or faces, if the shapes do not fit, if a coordinate is not finite or a
            face names a vertex that does not exist.
    """

    vertices: Float[np.ndarray, "n d"]
    faces: Int[np.ndarray, "m d"]
    normals: Float[np.ndarray, "n d"] | None
    frame: Frame
    name: str
    _told: list[bool] = field(init=False)
    is_costly: ClassVar[bool] = True  # type: ignore[misc]

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        normals: ArrayLike | None = None,
        frame: Frame | None = None,
        name: str = "Mesh",
    ) -> None:
        vertices, faces = np.array(vertices, dtype=np.float64), np.array(faces)
        if vertices.ndim != 2 or vertices.shape[1] not in (2, 3):
            raise ValueError(f"{name}: the vertices have the shape {vertices.shape}; wanted is (n, 3), or (n, 2).")
        d = vertices.shape[1]
        if not len(vertices):
            raise ValueError(f"{name}: the mesh is empty, it has no vertices.")
        if not faces.size:
            raise ValueError(
                f"{name}: the mesh has {len(vertices)} points and no faces. Without faces it is a `PointCloud`."
            )
        if faces.ndim != 2 or faces.shape[1] != d or faces.dtype.kind not in "iu":
            kind = "triangles" if d == 3 else "segments"
            raise ValueError(
                f"{name}: the faces are {faces.dtype} of the shape {faces.shape}; wanted are {kind}, whole numbers of "
                f"the shape (m, {d})."
            )
        if len(lost := np.flatnonzero(~np.isfinite(vertices).all(1))):
            raise ValueError(
                f"{name}: {len(lost)} of {len(vertices)} vertices have NaN or infinite coordinates, the first is "
                f"vertex {lost[0]} at {tuple(vertices[lost[0]].tolist())}. Remove or repair them."
            )
        if len(bad := np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(1))):
            raise ValueError(
                f"{name}: {len(bad)} of {len(faces)} faces name a vertex that does not exist, the first is face "
                f"{bad[0]} with vertices {tuple(faces[bad[0]].tolist())}; they are numbered 0 to {len(vertices) - 1}."
            )
        if normals is not None:
            normals = np.array(normals, dtype=np.float64)
            if normals.shape != vertices.shape:
                raise ValueError(f"{name}: the normals have the shape {normals.shape}, the vertices {vertices.shape}.")
            normals.flags.writeable = False
        faces = faces.astype(np.int64)
        vertices.flags.writeable = faces.flags.writeable = False
        for attribute, value in (
            ("vertices", vertices),
            ("faces", faces),
            ("normals", normals),
            ("frame", frame if frame is not None else Frame((0.0,) * d, 1.0)),
            ("name", name),
            ("_told", []),
        ):
            object.__setattr__(self, attribute, value)

    def __repr__(self) -> str:
        return f"Mesh({self.name!r}, {len(self.vertices)} vertices, {len(self.faces)} faces)"

    def __getstate__(self) -> dict:
        # The search trees are foreign objects, quickly built again.
        return {key: value for key, value in self.__dict__.items() if key != "_search"}

    @classmethod
    def read(cls, path: str | Path) -> Mesh:
        """Reads OBJ, PLY, STL, OFF, GLB or glTF, and cleans what those formats leave dirty.

        Polygons become triangles. Vertices at the same position are joined along open edges, so that texture seams
        and triangle soups close; faces that so lose a side and vertices of no face are left out. All bodies of the
        file are in the one mesh. Faces that point inward are turned, with a `MeshWarning`. A PLY or OBJ file of
        segments is read as a mesh in the plane. Vertex normals are kept from PLY files that need none of this.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file does not hold a mesh; the message says what it holds.
        """
        contents = read_contents(path, call="Mesh.read", formats=(".obj", ".ply", ".stl", ".off", ".glb", ".gltf"))
        name, vertices = Path(path).name, contents.vertices
        if not len(contents.sizes):
            raise ValueError(
                f"Mesh.read: {name!r} has {len(vertices)} points and no faces; read it with `PointCloud.read`."
                if len(vertices)
                else f"Mesh.read: {name!r} is empty, it has no vertices and no faces."
            )
        owner = np.repeat(np.arange(len(contents.sizes)), contents.sizes)
        if len(bad := np.flatnonzero((contents.corners < 0) | (contents.corners >= len(vertices)))):
            raise ValueError(
                f"Mesh.read: face {owner[bad[0]] + 1} of {name!r} names vertex {contents.corners[bad[0]] + 1}, and "
                f"there are {len(vertices)}. The file may be cut off."
            )
        if (contents.sizes == 2).all() and (vertices.shape[1] == 2 or not vertices[:, 2].any()):
            vertices, faces = vertices[:, :2], contents.corners.reshape(-1, 2)
        elif vertices.shape[1] == 2:
            raise ValueError(
                f"Mesh.read: {name!r} has polygons whose vertices have two coordinates. In the plane a mesh is made "
                "of segments, `l` in OBJ and `edge` in PLY; in space give a z."
            )
        else:
            with np.errstate(invalid="ignore"):
                faces = simplices.triangulated(vertices, contents.corners, contents.sizes)
        joined = simplices.without_degenerate(simplices.joined(vertices, simplices.without_degenerate(faces)))
        if not len(joined):
            raise ValueError(
                f"Mesh.read: none of the {len(contents.sizes)} faces of {name!r} has three different corners."
            )
        normals = contents.normals if np.array_equal(joined, faces) else None
        used, numbers = np.unique(joined, return_inverse=True)
        mesh = cls(
            vertices[used],
            numbers.reshape(joined.shape),
            normals=simplices.unit(normals[used]) if normals is not None else None,
            name=name,
        )
        turned = mesh.oriented()
        if turned is not mesh:
            count = int((turned.faces != mesh.faces).any(1).sum())
            what = "the faces point" if count == len(mesh.faces) else f"{count} of {len(mesh.faces)} faces point"
            warnings.warn(
                f"{name}: {what} inward (volume {mesh.volume:.6g}); turned outward.", MeshWarning, stacklevel=2
            )
        return turned

    def write(self, path: str | Path) -> None:
        """Writes PLY (binary), OBJ, OFF or STL (binary), in the units of the file the mesh came from.

        A normalised mesh goes back through its `frame`. The file appears whole or not at all. PLY has float32
        coordinates unless they are so far from the origin that this would move vertices by a millionth of the size;
        PLY and OBJ carry the vertex normals. STL is float32 always.

        Raises:
            FileNotFoundError: If the folder does not exist.
            ValueError: If the extension is not known.
        """
        mesh = self.restored()
        write_contents(path, mesh.vertices, mesh.faces, mesh.normals, call="Mesh.write")

    def normalized(self, margin: float = 0.0) -> Mesh:
        """The mesh moved and scaled so that the longest side of its box is [-1 + margin, 1 - margin].

        Raises:
            ValueError: If the margin is not in [0, 1), or if all vertices are in one point.
        """
        if not 0 <= margin < 1:
            raise ValueError(f"{self.name}: `normalized(margin={margin})` wants a margin from 0 to below 1.")
        if not max(self.box.size):
            raise ValueError(f"{self.name}: all vertices are at {self.box.center}; nothing to normalise.")
        inner = Frame(self.box.center, max(self.box.size) / 2 / (1 - margin))
        center, scale = np.array(self.frame.center), self.frame.scale
        frame = Frame(tuple((center + scale * np.array(inner.center)).tolist()), scale * inner.scale)
        return self._moved((self.vertices - inner.center) / inner.scale, frame)

    def restored(self) -> Mesh:
        """The mesh back in the units of the file, the inverse of `normalized`."""
        identity = Frame((0.0,) * self.vertices.shape[1], 1.0)
        if self.frame == identity:
            return self
        return self._moved(np.array(self.frame.center) + self.frame.scale * self.vertices, identity)

    def _moved(self, vertices: np.ndarray, frame: Frame) -> Mesh:
        mesh = Mesh(vertices, self.faces, normals=self.normals, frame=frame, name=self.name)
        object.__setattr__(mesh, "_told", self._told)
        return mesh

    def oriented(self) -> Mesh:
        """The mesh with its faces turned outward; the mesh itself if they are.

        All faces are turned if the volume is negative. Then a closed body that still faces inward is turned on its
        own, unless it lies inside another one, where it bounds a cavity.
        """
        flip = np.full(len(self.faces), self.volume < -1e-9 * self.area * max(self.box.size))
        turned = np.where(flip[:, None], self.faces[:, ::-1], self.faces)
        count, labels = simplices.face_components(turned, len(self.vertices))
        if count > 1:
            centroids = self.vertices[turned].mean(1) - self.box.center
            pyramids = (simplices.area_vectors(self.vertices, turned) * centroids).sum(1)
            inward = np.bincount(labels, pyramids) < 0
            inward[np.unique(labels[simplices.open_faces(turned, len(self.vertices))])] = False
            if inward.any():
                order = np.lexsort((-self.face_areas, labels))
                largest = order[np.searchsorted(labels[order], np.flatnonzero(inward))]
                normal = simplices.unit(simplices.area_vectors(self.vertices, turned[largest]))
                step = 1e-4 * max(self.box.size) * normal
                center = self.vertices[turned[largest]].mean(1)
                around = TriangleDistance(self.vertices, turned).winding(np.concatenate([center + step, center - step]))
                inward[inward] = around.reshape(2, -1).mean(0) < 0
                flip ^= inward[labels]
        if not flip.any():
            return self
        # Normals of the vertices would have to be turned with some bodies and not with others.
        faces = np.where(flip[:, None], self.faces[:, ::-1], self.faces)
        return Mesh(self.vertices, faces, frame=self.frame, name=self.name)

    @cached_property
    def box(self) -> Box:
        """The smallest box around the vertices."""
        return Box.around(self.vertices)

    @cached_property
    def face_areas(self) -> Float[np.ndarray, " m"]:
        """The area of each triangle, or the length of each segment."""
        return np.linalg.norm(simplices.area_vectors(self.vertices, self.faces), axis=1)

    @cached_property
    def face_normals(self) -> Float[np.ndarray, "m d"]:
        """The unit normal of each face; zero where a face has no area."""
        return simplices.unit(simplices.area_vectors(self.vertices, self.faces))

    @cached_property
    def vertex_normals(self) -> Float[np.ndarray, "n d"]:
        """The `normals` given with the mesh, or else the mean over the faces weighted by their angles."""
        return simplices.vertex_normals(self.vertices, self.faces) if self.normals is None else self.normals

    @cached_property
    def area(self) -> float:
        """The area of the surface, or the length of the curve."""
        return float(self.face_areas.sum())

    @cached_property
    def volume(self) -> float:
        """The enclosed volume (area in the plane), negative if the faces point inward.

        Holes of an open mesh count as closed by cones to the centre of its box.
        """
        return simplices.signed_volume(self.vertices, self.faces)

    @cached_property
    def is_watertight(self) -> bool:
        """Whether every edge belongs to exactly two faces, which run through it in opposite directions."""
        return simplices.is_watertight(self.faces, len(self.vertices))

    @cached_property
    def components(self) -> int:
        """The number of bodies: sets of faces connected through shared vertices."""
        return simplices.face_components(self.faces, len(self.vertices))[0]

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        """n points drawn uniformly by area, with the normals of their faces.

        Raises:
            ValueError: If the mesh has no area.
        """
        if not self.area > 0:
            raise ValueError(f"{self.name}: the faces have no area; nothing can be sampled.")
        device, d = generator.device, self.vertices.shape[1]
        total = torch.tensor(np.cumsum(self.face_areas), device=device)
        u = torch.rand(n, d, generator=generator, dtype=torch.float64, device=device)
        face = torch.searchsorted(total, u[:, 0] * total[-1], right=True).clamp_(max=len(total) - 1)
        corners = torch.tensor(self.vertices, device=device)[torch.tensor(self.faces, device=device)[face]]
        spread = u[:, 1:] if d == 2 else torch.stack([1 - u[:, 1].sqrt(), u[:, 1].sqrt() * u[:, 2]], 1)
        weights = torch.cat([1 - spread.sum(1, keepdim=True), spread], 1)
        return Samples((weights[:, :, None] * corners).sum(1), torch.tensor(self.face_normals, device=device)[face])

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """The exact distance to the faces, negative where the winding number is above 1/2.

        Computed in float64 on the CPU, whatever x is. It can be differentiated once with respect to x: the gradient
        is the direction away from the closest point, on the surface the normal of the face. The first call warns if
        the sign is uncertain somewhere.

        Raises:
            ValueError: If x has another number of coordinates than the mesh.
        """
        d = self.vertices.shape[1]
        if x.ndim != 2 or x.shape[1] != d:
            raise ValueError(f"{self.name}: `distance(x)` got x of the shape {tuple(x.shape)}; wanted is (n, {d}).")
        self._warn_of_uncertainty()
        points = x.detach().cpu().double().numpy()
        closest = self._search.closest(points)
        sign = np.where(self._search.winding(points) > 0.5, -1.0, 1.0)
        distance = x.new_tensor(sign * closest.distance)
        if not x.requires_grad:
            return distance
        away = simplices.unit(points - closest.point) * sign[:, None]
        touching = closest.distance <= 1e-12 * max(self.box.size)
        gradient = np.where(touching[:, None], self.face_normals[closest.face], away)
        return distance + ((x - x.detach()) * x.new_tensor(gradient)).sum(1)

    def closest(self, x: Real[np.ndarray, "n d"]) -> Closest:
        """The nearest points of the mesh with their unsigned distances and faces, in numpy."""
        return self._search.closest(np.asarray(x, dtype=np.float64))

    @cached_property
    def _search(self) -> TriangleDistance:
        return TriangleDistance(self.vertices, self.faces)

    def sign_uncertainty(self) -> SignUncertainty:
        """Looks for places where inside and outside are unclear: 20,000 points in the box, 20,000 at the surface."""
        return self._sign_uncertainty

    @cached_property
    def _sign_uncertainty(self) -> SignUncertainty:
        generator = torch.Generator().manual_seed(0)
        size = max(self.box.size)
        inside = self.box.expanded(0.025 * size).uniform(20_000, generator=generator).numpy()
        points, normals = (part.numpy() for part in self.sample(10_000, generator=generator))
        near = np.concatenate([points + 1e-4 * size * normals, points - 1e-4 * size * normals])
        unclear, unclear_near = (
            np.minimum(np.abs(w), np.abs(w - 1)) > 0.25 for w in map(self._search.winding, (inside, near))
        )
        found = np.concatenate([inside[unclear], near[unclear_near]])
        region = None
        if len(found):
            region = Box.around(np.array(self.frame.center) + self.frame.scale * found)
        return SignUncertainty(
            open_edges=int(simplices.open_pieces(self.faces, len(self.vertices)).sum()),
            share=float(unclear.mean()),
            surface_share=float(unclear_near.reshape(2, -1).any(0).mean()),
            region=region,
        )

    def _warn_of_uncertainty(self) -> None:
        if self._told:
            return
        self._told.append(True)
        found = self.sign_uncertainty()
        if not found.open_edges and found.share < 1e-4 and found.surface_share < 5e-3:
            return
        if found.open_edges:
            unit = "edges" if self.vertices.shape[1] == 3 else "end points"
            cause = f"it is open ({found.open_edges} {unit} without a matching neighbour)"
        else:
            cause = "parts of it overlap or face inward"
        if found.region is None:
            where = "close to those edges only"
        else:
            low, high = (
                "(" + ", ".join(f"{c:.4g}" for c in corner) + ")" for corner in (found.region.lower, found.region.upper)
            )
            where = f"between {low} and {high}"
        share = f"{100 * found.share:.2g} %" if found.share else "less than 0.01 %"
        warnings.warn(
            f"{self.name}: the sign of the distance is uncertain, because {cause}: {where}, {share} of its box. "
            "There a point counts as inside where the winding number is above 1/2.",
            MeshWarning,
            stacklevel=3,
        )
