"""Pictures of surfaces: one, or many side by side for comparison."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from levelflow.extraction import EmptyLevelSet
from levelflow.fields import Field
from levelflow.rendering.camera import Camera
from levelflow.rendering.colours import Scale, bar_width, linear, srgb, with_bar
from levelflow.rendering.curves import draw
from levelflow.rendering.hits import Hits
from levelflow.rendering.quantities import Quantity
from levelflow.rendering.rasterising import hits_on, rasterise
from levelflow.rendering.shading import Clay, Normals, shade
from levelflow.rendering.tracing import framed, sphere_trace
from levelflow.shapes.mesh import Mesh
from levelflow.shapes.writing import replace_file

_INK, _FAINT = (64, 60, 56), (150, 145, 140)


def image(
    surface: Mesh | Field,
    camera: Camera | None = None,
    *,
    size: int | tuple[int, int] = 512,
    material: Clay | Normals = Clay(),  # noqa: B008
    values: Quantity | Float[np.ndarray, " n"] | None = None,
    scale: Scale | None = None,
    supersampling: int = 2,
) -> UInt8[np.ndarray, "h w 3"]:
    """A picture of a surface (d = 3) or of a filled curve (d = 2).

    A mesh is rasterised. A field is traced, without a mesh in between: every pixel shows its surface itself.

    Args:
        surface: A mesh, whose front faces and back faces have different colours, so that openings and flipped faces
            are seen; or a field over three space coordinates, without times, with a box.
        camera: By default one that frames the surface from the front right.
        size: Pixels, or (height, width).
        material: The colours; `Normals()` shows directions.
        values: Numbers shown by colours, with a colour bar on the right: a quantity, or one number for each vertex.
        scale: What the colours stand for; by default fitted to the values at the surface.
        supersampling: Samples per pixel and axis, of a field at edges only; edges are antialiased by their mean in
            linear light.

    Returns:
        sRGB values (h, w, 3).

    Raises:
        ValueError: If the size or the supersampling is not positive, or the numbers do not fit the surface.
        EmptyLevelSet: If a field has no surface that is seen in its box.
    """
    height, width = (size, size) if isinstance(size, int) else size
    if height < 1 or width < 1 or supersampling < 1:
        raise ValueError(
            f"image(size={size}, supersampling={supersampling}): a picture has at least one pixel and one sample."
        )
    if camera is None:
        camera = framed(surface) if isinstance(surface, Field) else Camera.around(surface.vertices)
    if isinstance(surface, Mesh) and surface.faces.shape[1] == 2:
        if values is not None or not isinstance(material, Clay):
            raise ValueError("image(mesh): a curve in the plane is drawn as clay, without values; leave them out.")
        h, w = height * supersampling, width * supersampling
        light = draw(surface, camera, height=h, width=w, material=material, line=max(min(h, w) / 128, 1.0))
        return _encoded(light.reshape(height, supersampling, width, supersampling, 3).mean((1, 3)))
    ground = linear(np.array(material.ground))
    if values is None:
        hits, _ = _seen(surface, None, camera, height, width, supersampling)
        return _encoded(hits.place(shade(hits, camera, material=material), background=ground))
    if width <= bar_width(height):
        raise ValueError(f"image(size={size}, values=...): there is no room for the colour bar; widen the picture.")
    hits, numbers = _seen(surface, values, camera, height, width - bar_width(height), supersampling)
    if scale is None:
        signed, label = (values.signed, values.label) if isinstance(values, Quantity) else (True, "")
        scale = Scale.of(numbers, signed=signed, label=label)
    clay = material if isinstance(material, Clay) else Clay(ground=material.ground)
    light = shade(hits, camera, material=clay, albedo=scale(numbers))
    picture = _encoded(hits.place(light, background=ground))
    return with_bar(picture, scale, ground=material.ground)


def _seen(
    surface: Mesh | Field,
    values: Quantity | np.ndarray | None,
    camera: Camera,
    height: int,
    width: int,
    samples: int,
) -> tuple[Hits, np.ndarray]:
    """What is seen, and the numbers there; none if none are asked for."""
    if isinstance(surface, Field):
        hits = sphere_trace(surface, camera, height=height, width=width, samples=samples)
        if not len(hits.pixels):
            raise EmptyLevelSet(
                "image(f): no surface is seen: it has vanished, lies outside the box of the field, or the camera looks "
                "elsewhere. `framed(f)` gives a camera that looks at it."
            )
        if isinstance(values, np.ndarray):
            raise ValueError("image(f, values=...): numbers at vertices need a mesh; give a `Quantity`.")
        return hits, np.zeros(0) if values is None else values.at(hits.points)
    raster = rasterise(surface, camera, height=height * samples, width=width * samples)
    hits = hits_on(raster, surface, camera, samples=samples)
    if values is None:
        return hits, np.zeros(0)
    numbers = values.at(surface.vertices) if isinstance(values, Quantity) else values
    if len(numbers) != len(surface.vertices):
        raise ValueError(
            f"image(mesh, values=...): {len(numbers)} values for {len(surface.vertices)} vertices; give one for each."
        )
    return hits, raster.interpolate(numbers[surface.faces][..., None])[:, 0]


def _encoded(light: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    return (255 * srgb(light) + 0.5).astype(np.uint8)


def contact_sheet(
    meshes: Sequence[Mesh | None],
    labels: Sequence[str],
    path: str | Path | None = None,
    *,
    columns: int | Sequence[int] | None = None,
    size: int = 384,
    title: str | None = None,
    camera: Camera | None = None,
    material: Clay = Clay(),  # noqa: B008
) -> UInt8[np.ndarray, "h w 3"]:
    """Pictures of meshes under one camera, so that sizes and places compare, each with its label below.

    Args:
        meshes: None stands for a surface that has vanished.
        labels: One for each.
        path: Where to write the sheet as a PNG, all of it or nothing; by default nowhere.
        columns: Pictures in a row, or in each of the rows, which then stand in the middle of the sheet: (1, 2, 3) is a
            triangle. By default all up to five, else about the square root of their number.
        size: Pixels of each picture.
        title: A line above.
        camera: By default one that frames all meshes.
        material: The colours.

    Returns:
        sRGB values (h, w, 3).

    Raises:
        ValueError: If there is nothing to show, not one label for each mesh, or the rows hold not as many.
    """
    from PIL import Image, ImageDraw, ImageFont

    meshes = list(meshes)
    if not meshes or len(meshes) != len(labels):
        raise ValueError(f"contact_sheet: {len(meshes)} meshes with {len(labels)} labels; give one label per mesh.")
    points = [mesh.vertices for mesh in meshes if mesh is not None]
    if camera is None and points:
        camera = Camera.around(np.concatenate(points))
    columns = columns or (len(meshes) if len(meshes) <= 5 else math.ceil(math.sqrt(len(meshes) * 1.2)))
    rows = [columns] * math.ceil(len(meshes) / columns) if isinstance(columns, int) else list(columns)
    places = [(number, row, own) for row, own in enumerate(rows) for number in range(own)]
    if not isinstance(columns, int) and len(places) != len(meshes):
        raise ValueError(f"contact_sheet(columns={columns}): the rows hold {len(places)} of {len(meshes)} meshes.")
    widest = max(rows)
    text = max(size // 20, 10)
    foot, head = 2 * text, round(2.6 * text) if title else 0
    ground = tuple(round(255 * c) for c in material.ground)
    sheet = Image.new("RGB", (widest * size, head + len(rows) * (size + foot)), ground)
    pen = ImageDraw.Draw(sheet)
    for mesh, label, (number, row, own) in zip(meshes, labels, places, strict=False):
        x, y = (widest - own) * size // 2 + number * size, head + row * (size + foot)
        if mesh is None:
            pen.text(
                (x + size / 2, y + size / 2), "vanished", _FAINT, ImageFont.load_default(text), "mm", align="center"
            )
        else:
            sheet.paste(Image.fromarray(image(mesh, camera, size=size, material=material)), (x, y))
        pen.text((x + size / 2, y + size + 0.6 * text), label, _INK, ImageFont.load_default(text), "mm")
    if title:
        pen.text((widest * size / 2, head / 2), title, _INK, ImageFont.load_default(round(1.3 * text)), "mm")
    picture = np.array(sheet)
    if path is not None:
        write(picture, path)
    return picture


def stack(pictures: Sequence[UInt8[np.ndarray, "h w 3"]], path: str | Path) -> None:
    """Writes pictures of one width below each other, all of them or nothing.

    Raises:
        ValueError: If there is none, or the widths differ.
    """
    widths = {picture.shape[1] for picture in pictures}
    if len(widths) != 1:
        raise ValueError(f"stack: the pictures have the widths {sorted(widths)}; give pictures of one width.")
    write(np.concatenate(list(pictures)), path)


def write(picture: UInt8[np.ndarray, "h w 3"], path: str | Path) -> None:
    """Writes a picture in the format of the file's extension; an older file is replaced at once or not at all."""
    from PIL import Image

    path, data = Path(path), io.BytesIO()
    Image.fromarray(picture).save(data, format=Image.registered_extensions().get(path.suffix.lower(), "PNG"))
    replace_file(path, data.getvalue())
