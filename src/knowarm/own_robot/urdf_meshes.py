"""Meshes of a URDF, copied or converted to files that MuJoCo reads, one per colour."""

import re
import shutil
from collections.abc import Callable
from copy import deepcopy
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from knowarm.errors import packages_of
from knowarm.reading import read_bytes, reading, refuse_pointer

MESHES = "meshes"
"""Folder of the files, beside the MJCF file."""
MOST_STL_FACES = 200_000  # More are not read by MuJoCo from an STL file


def remove_children(element: Element, tag: str) -> None:
    """Remove the children of an element that have a tag."""
    for child in element.findall(tag):
        element.remove(child)


def convert_meshes(
    root: Element, folder: Path, find: Callable[[str], Path]
) -> list[str]:
    """Copy or convert the meshes of a URDF into a folder; a visual per colour refers to them.

    ``find`` returns the file of a mesh by its name. Return the names of textures and textured
    meshes.
    """
    folder.mkdir(parents=True)
    textured: list[str] = []
    known: dict[tuple[Path, str], dict[Path, str | None]] = {}
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            shape.attrib.pop("name", None)  # MuJoCo takes no name twice
            for material in shape.findall("material"):
                textured += [t.get("filename", "") for t in material.iter("texture")]
                remove_children(material, "texture")
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            source = find(mesh.get("filename", ""))
            key = (source, shape.tag)
            if key not in known:
                stem = re.sub("[^A-Za-z0-9]+", "_", source.stem)
                target = folder / f"{shape.tag}_{len(known)}_{stem}"
                is_visual = shape.tag == "visual"
                known[key] = _convert_mesh(source, target, is_visual, textured)
            link.remove(shape)
            for file, rgba in known[key].items():
                mesh.set("filename", f"{MESHES}/{file.name}")
                part = deepcopy(shape)
                if rgba is not None:
                    remove_children(part, "material")
                    material = SubElement(part, "material", name=file.stem)
                    SubElement(material, "color", rgba=rgba)
                link.append(part)
    return list(dict.fromkeys(textured))


def _convert_mesh(
    source: Path, target: Path, is_visual: bool, textured: list[str]
) -> dict[Path, str | None]:
    """Copy a binary STL file; split another mesh by its colours, which collisions do without.

    Return the files, each with its colour; None for none. Add a name to those ``textured``.
    """
    refuse_pointer(source)
    if _is_binary_stl(source):
        return {Path(shutil.copyfile(source, target.with_suffix(".stl"))): None}
    with packages_of("urdf", f"The mesh {source}"):
        import trimesh

        import_module("collada")  # with which trimesh reads COLLADA
    files: dict[Path, str | None] = {}
    remedy = "Give a mesh that trimesh reads, such as STL, OBJ or COLLADA."
    with reading(source, remedy):
        groups: dict[str | None, list[Any]] = {}
        for mesh in trimesh.load_scene(source).dump():
            if isinstance(mesh, trimesh.Trimesh):
                if "*" in (mesh.units or ""):  # COLLADA's, such as 0.01 * meters
                    mesh.convert_units("meters")
                rgba = None
                if is_visual:
                    rgba = _rgba(mesh)
                    if _image(mesh) is not None:
                        textured.append(source.name)
                groups.setdefault(rgba, []).append(mesh)
        if not groups:
            raise ValueError("it has no faces")
        for i, (rgba, meshes) in enumerate(groups.items()):
            whole: Any = trimesh.util.concatenate(meshes)
            suffix = ".stl" if len(whole.faces) <= MOST_STL_FACES else ".obj"
            file = target.with_name(f"{target.name}_{i}{suffix}")
            whole.export(file)
            files[file] = rgba
    return files


def _is_binary_stl(path: Path) -> bool:
    """Return whether MuJoCo reads a file as it is."""
    data = read_bytes(path)
    faces = int.from_bytes(data[80:84], "little")
    has_size = len(data) == 84 + 50 * faces
    return path.suffix.lower() == ".stl" and has_size and 0 < faces <= MOST_STL_FACES


def _image(mesh: Any) -> Any:
    """Return the texture of a mesh, or None."""
    material = getattr(mesh.visual, "material", None)
    image = getattr(material, "image", None)
    return image or getattr(material, "baseColorTexture", None)


def _rgba(mesh: Any) -> str | None:
    """Return the mean colour of a mesh in URDF's notation, or None if it has none."""
    if not mesh.visual.defined:
        return None
    material = getattr(mesh.visual, "material", None) or mesh.visual
    image = _image(mesh)
    if image is not None:
        colour = np.asarray(image.convert("RGBA"), float).reshape(-1, 4).mean(axis=0)
    else:
        colour = np.asarray(material.main_color)
    return " ".join(f"{value:.3g}" for value in colour / 255)
