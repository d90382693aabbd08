"""Pictures of meshes: one, or many side by side for comparison."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from levelflow.rendering.camera import Camera
from levelflow.rendering.curves import draw
from levelflow.rendering.rasterising import rasterise
from levelflow.rendering.shading import Clay, linear, shade, srgb
from levelflow.shapes.mesh import Mesh
from levelflow.shapes.writing import replace_file

_INK, _FAINT = (64, 60, 56), (150, 145, 140)


def image(
    mesh: Mesh,
    camera: Camera | None = None,
    *,
    size: int | tuple[int, int] = 512,
    material: Clay = Clay(),  # noqa: B008
    supersampling: int = 2,
) -> UInt8[np.ndarray, "h w 3"]:
    """A picture of a surface (d = 3) or of a filled curve (d = 2).

    Args:
        mesh: Its front faces and back faces have different colours, so openings and flipped faces are seen.
        camera: By default one that frames the mesh from the front right.
        size: Pixels, or (height, width).
        material: The colours.
        supersampling: Samples per pixel and axis; edges are antialiased by their mean in linear light.

    Returns:
        sRGB values (h, w, 3).

    Raises:
        ValueError: If the size or the supersampling is not positive.
    """
    height, width = (size, size) if isinstance(size, int) else size
    if height < 1 or width < 1 or supersampling < 1:
        raise ValueError(
            f"image(size={size}, supersampling={supersampling}): a picture has at least one pixel and one sample."
        )
    camera = Camera.around(mesh.vertices) if camera is None else camera
    h, w = height * supersampling, width * supersampling
    if mesh.faces.shape[1] == 2:
        light = draw(mesh, camera, height=h, width=w, material=material, line=max(min(h, w) / 128, 1.0))
    else:
        raster = rasterise(mesh, camera, height=h, width=w)
        colours = shade(raster, mesh, camera, material=material).astype(np.float32)
        light = raster.place(colours, background=linear(np.array(material.ground)))
    light = light.reshape(height, supersampling, width, supersampling, 3).mean((1, 3))
    return (255 * srgb(light) + 0.5).astype(np.uint8)


def contact_sheet(
    meshes: Sequence[Mesh | None],
    labels: Sequence[str],
    path: str | Path | None = None,
    *,
    columns: int | None = None,
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
        columns: Pictures in a row; by default all up to five, else about the square root of their number.
        size: Pixels of each picture.
        title: A line above.
        camera: By default one that frames all meshes.
        material: The colours.

    Returns:
        sRGB values (h, w, 3).

    Raises:
        ValueError: If there is nothing to show, or not one label for each mesh.
    """
    from PIL import Image, ImageDraw, ImageFont

    meshes = list(meshes)
    if not meshes or len(meshes) != len(labels):
        raise ValueError(f"contact_sheet: {len(meshes)} meshes with {len(labels)} labels; give one label per mesh.")
    points = [mesh.vertices for mesh in meshes if mesh is not None]
    if camera is None and points:
        camera = Camera.around(np.concatenate(points))
    columns = columns or (len(meshes) if len(meshes) <= 5 else math.ceil(math.sqrt(len(meshes) * 1.2)))
    rows = math.ceil(len(meshes) / columns)
    text = max(size // 20, 10)
    foot, head = 2 * text, round(2.6 * text) if title else 0
    ground = tuple(round(255 * c) for c in material.ground)
    sheet = Image.new("RGB", (columns * size, head + rows * (size + foot)), ground)
    pen = ImageDraw.Draw(sheet)
    for i, (mesh, label) in enumerate(zip(meshes, labels, strict=True)):
        x, y = (i % columns) * size, head + (i // columns) * (size + foot)
        if mesh is None:
            pen.text(
                (x + size / 2, y + size / 2), "vanished", _FAINT, ImageFont.load_default(text), "mm", align="center"
            )
        else:
            sheet.paste(Image.fromarray(image(mesh, camera, size=size, material=material)), (x, y))
        pen.text((x + size / 2, y + size + 0.6 * text), label, _INK, ImageFont.load_default(text), "mm")
    if title:
        pen.text((columns * size / 2, head / 2), title, _INK, ImageFont.load_default(round(1.3 * text)), "mm")
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
