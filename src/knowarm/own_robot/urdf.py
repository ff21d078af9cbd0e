"""URDF and xacro files, converted to an MJCF file with its meshes beside it."""

import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from functools import partial
from importlib import import_module
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from urllib.parse import unquote
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import mujoco
import numpy as np

from knowarm.arrays import Floats
from knowarm.errors import UserError, packages_of
from knowarm.private_apis import xacro_packages
from knowarm.reading import (
    one_line,
    read_bytes,
    read_text,
    reading,
    refuse_pointer,
    writing,
)

MOST_NESTED = 300
"""Most XML elements inside each other; MJCF nests one per joint."""
MODEL_SUFFIXES = (".xml", ".mjcf", ".urdf", ".xacro")
"""Files with these suffixes hold a bare model, for which a description is drafted."""

XACRO = ".xacro"
XACRO_MARKS = re.compile(r"[/.]ros\.org/[^\"]*xacro|\$[{(]")
"""Of the namespace of xacro's elements, where there are any, and of its expressions."""

MESHES = "meshes"
LEVELS = 5  # Folders above a file in which and beside which its packages are searched
MOST_STL_FACES = 200_000  # More are not read by MuJoCo from an STL file
VISUAL_GROUP = 1  # MuJoCo's of a URDF's visuals
COLLISION_GROUP = 3  # Is not drawn
LEAST_KG = 1e-4  # Of a link that moves
LEAST_INERTIA = 1e-6  # [kg m^2]
ROUNDING = 1e-4  # Relative error of inertias as they are written
COMPILER = {
    "discardvisual": "false",
    "fusestatic": "false",
    "strippath": "false",
}
"""Options of MuJoCo's compiler that keep visuals and fixed links."""


FindPackage = Callable[[str], Path]
"""Returns the folder of a ROS package."""


class _Part(NamedTuple):
    """One colour of a mesh."""

    file: Path
    rgba: str | None  # None: the file has no colours
    is_textured: bool = False


def as_mjcf(
    path: Path,
    folder: Path,
    *,
    arguments: Sequence[str] = (),
    packages: Sequence[str] = (),
) -> tuple[Path, str]:
    """Return the MJCF file of a robot's file, and what was done to convert it ("" for MJCF).

    A URDF or xacro file is converted into a new ``folder``. ``arguments`` of xacro have the form
    ``name:=value``, and ``packages`` that its meshes and includes lie in ``name=folder``.

    Raises:
        UserError: a package, mesh or library is missing, or the file is invalid.
    """
    folders = _folders(_pairs("--package", packages, "="))
    find = partial(_find_package, path, folders)
    root = None
    refuse_pointer(path)
    if path.suffix != XACRO and path.is_file():
        text = read_text(path, remedy="Give a URDF, xacro or MJCF file.")
        try:
            root = ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            raise UserError(f"{path} is not valid XML: {one_line(error)}.") from None
        _refuse_nested(root, path)
    if path.suffix == XACRO or (root is not None and _is_xacro(root)):
        root = _expand(path, find, _pairs("--xacro", arguments, ":="))
    elif arguments:
        raise UserError(f"--xacro needs a {XACRO} file, got {path}.")
    if root is None or root.tag != "robot":
        return path, ""
    if folder.exists():
        raise UserError(
            f"The folder {folder} for the converted model exists; remove or rename it."
        )
    notes = [f"converted from {path.name}", *_repair_inertias(root)]
    notes += _set_limits(root, path)
    name = path.with_suffix("").stem + ".xml"
    with TemporaryDirectory() as temporary:
        file = Path(temporary) / name
        _set_compiler(root)
        textured = _convert_meshes(root, path, file.with_name(MESHES), find)
        if textured:
            notes.append(f"textures drawn as one colour: {', '.join(textured)}")
        ElementTree.ElementTree(root).write(file)
        try:
            file.write_text(_compile(file), encoding="utf-8")
        except (ValueError, mujoco.FatalError) as error:
            raise UserError(
                f"{path} cannot be converted: {one_line(error)}. Correct it."
            ) from None
        with writing(folder):
            shutil.copytree(temporary, folder)
    return folder / name, "; ".join(notes)


def _compile(file: Path) -> str:
    """Return the MJCF of a URDF whose meshes MuJoCo reads."""
    spec = mujoco.MjSpec.from_file(str(file))
    for mesh in spec.meshes:  # a visual has no mass, and may have no volume
        if mesh.name.startswith("visual"):
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    # Images show what a viewer of URDF does, and no safety boxes.
    if VISUAL_GROUP in [geom.group for geom in spec.geoms]:
        for geom in spec.geoms:
            geom.group = geom.group or COLLISION_GROUP
    for body in spec.bodies[1:]:  # frames without shape, such as tool0
        if not (list(body.geoms) or list(body.joints) or list(body.bodies)):
            body.add_site(name=body.name)
    spec.compile()
    return spec.to_xml()


def _pairs(option: str, values: Sequence[str], sign: str) -> dict[str, str]:
    """Read the values of an option by name."""
    pairs = {}
    for text in values:
        name, _, value = text.partition(sign)
        if not name or not value:
            raise UserError(
                f"{option} must have the form name{sign}value, got {text!r}."
            )
        pairs[name] = value
    return pairs


def _folders(packages: Mapping[str, str]) -> dict[str, Path]:
    """Return the folders of packages that are given by name."""
    folders = {}
    for name, text in packages.items():
        folder = Path(text).expanduser().resolve()
        if not folder.is_dir():
            raise UserError(
                f"--package {name}={text}: there is no folder {folder}. Give that of the package."
            )
        folders[name] = folder
    return folders


def _refuse_nested(root: Element, path: Path) -> None:
    """Refuse XML whose elements lie so deep in each other that no robot is described so."""
    level = [root]
    for _ in range(MOST_NESTED):
        level = list(chain.from_iterable(level))
        if not level:
            return
    raise UserError(
        f"{path} nests XML elements more than {MOST_NESTED} deep, as no robot's file does. Give a "
        "URDF, xacro or MJCF file."
    )


def _is_xacro(root: Element) -> bool:
    """Return whether a robot's XML has xacro's elements or expressions."""
    text = ElementTree.tostring(root, encoding="unicode")
    return root.tag == "robot" and bool(XACRO_MARKS.search(text))


def _expand(path: Path, find: FindPackage, arguments: Mapping[str, str]) -> Element:
    """Expand a xacro file."""
    with packages_of("urdf", f"The xacro file {path}"):
        import xacro
    remedy = "Give a xacro file, and --xacro name:=value if it requires arguments."
    with reading(path, remedy), xacro_packages(lambda name: str(find(name))):
        try:
            document = xacro.process_file(
                str(path.absolute()), mappings=dict(arguments)
            )
        except xacro.XacroException as error:
            raise error.exc if isinstance(error.exc, UserError) else error from None
        return ElementTree.fromstring(document.toxml())


def _find_package(path: Path, given: Mapping[str, Path], name: str) -> Path:
    """Return the folder of a ROS package: given, or above the file or beside such a folder."""
    if name in given:
        return given[name]
    for above in path.absolute().parents[:LEVELS]:
        beside = sorted(entry for entry in above.iterdir() if entry.is_dir())
        for folder in (above, *beside):
            if name == _package_name(folder):
                return folder
    raise UserError(
        f"Package {name!r} of {path} is not found in the {LEVELS} folders above it, nor beside "
        f"them. Give its folder: --package {name}=FOLDER."
    )


def _package_name(folder: Path) -> str:
    """Return the name in the package.xml of a folder, else the folder's."""
    try:
        name = ElementTree.parse(folder / "package.xml").findtext("name")
    except (OSError, ElementTree.ParseError):
        name = None
    return (name or folder.name).strip()


def _set_compiler(root: Element) -> None:
    """Set the options of MuJoCo's compiler in a URDF."""
    extension = root.find("mujoco")
    if extension is None:
        extension = SubElement(root, "mujoco")
    _remove(extension, "compiler")
    SubElement(extension, "compiler", COMPILER)


def _remove(element: Element, tag: str) -> None:
    """Remove the children of an element that have a tag."""
    for child in element.findall(tag):
        element.remove(child)


SOFT_LIMITS = {"soft_lower_limit", "soft_upper_limit"}
"""Attributes of a joint's safety_controller."""


def _set_limits(root: Element, path: Path) -> Iterator[str]:
    """Take the soft limits of joints, which a controller enforces; name those joints.

    Raises:
        UserError: a lower limit is above its upper one.
    """
    softened = []
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        limit = joint.find("limit")
        if limit is None or joint.get("type") not in ("revolute", "prismatic"):
            continue
        low = _number(limit, "lower", path, name)
        high = _number(limit, "upper", path, name)
        if low > high:
            raise UserError(
                f"Joint {name!r} of {path} has a lower limit of {low:g} and an upper one of "
                f"{high:g}. Exchange or correct them in the file."
            )
        soft = joint.find("safety_controller")
        if soft is None or not set(soft.attrib) >= SOFT_LIMITS:
            continue
        soft_low = _number(soft, "soft_lower_limit", path, name)
        soft_high = _number(soft, "soft_upper_limit", path, name)
        ends = (max(low, soft_low), min(high, soft_high))
        if ends != (low, high) and ends[0] < ends[1]:
            limit.attrib.update(lower=str(ends[0]), upper=str(ends[1]))
            softened.append(name)
    if softened:
        yield f"soft limits taken for {', '.join(softened)}"


def _number(element: Element, key: str, path: Path, joint: str) -> float:
    """Return a number among the attributes of a joint's element, by default 0."""
    text = element.get(key, "0")
    try:
        return float(text)
    except ValueError:
        raise UserError(
            f"Joint {joint!r} of {path}: {key} is {text!r}, which is no number. Correct the file."
        ) from None


def _repair_inertias(root: Element) -> Iterator[str]:
    """Make the inertias of a URDF possible; name the links that move and whose inertia is not."""
    moved = []
    for joint in root.iter("joint"):
        if joint.get("type") != "fixed":
            moved += [child.get("link") for child in joint.findall("child")]
    missing = []
    repaired = []
    for link in root.findall("link"):
        name = link.get("name", "")
        inertia = link.find("inertial/inertia")
        mass = link.find("inertial/mass")
        if inertia is None or mass is None:
            _add_inertia(link)
            if name in moved:
                missing.append(name)
        elif _repair_inertia(inertia, mass) and name in moved:
            repaired.append(name)
    if missing:
        yield f"inertia from shapes or least values, as the file has none: {', '.join(missing)}"
    if repaired:
        yield f"impossible inertia repaired: {', '.join(repaired)}"


def _add_inertia(link: Element) -> None:
    """Give a link without shape that can collide the least inertia."""
    if link.find("collision") is None:
        inertial = SubElement(link, "inertial")
        SubElement(inertial, "mass", value=str(LEAST_KG))
        SubElement(inertial, "inertia", _attributes(LEAST_INERTIA * np.eye(3)))


def _repair_inertia(inertia: Element, mass: Element) -> bool:
    """Make an inertia possible; return whether it was not."""
    kg = float(mass.get("value", 0))
    matrix = np.zeros((3, 3))
    matrix[_UPPER] = [float(inertia.get(key, 0)) for key in _ATTRIBUTES]
    values, axes = np.linalg.eigh(matrix + np.triu(matrix, 1).T)
    too_small = kg < LEAST_KG or values[0] <= 0
    too_long = values[:2].sum() < values[2] * (1 - ROUNDING)
    if too_small or too_long:
        values = np.maximum(values, LEAST_INERTIA)
        if values[:2].sum() < values[2]:
            values[:] = values.mean()  # as MuJoCo's balanceinertia does
    values[2] = min(values[2], values[:2].sum() * (1 - ROUNDING))
    inertia.attrib.update(_attributes(axes @ np.diag(values) @ axes.T))
    mass.set("value", str(max(kg, LEAST_KG)))
    return bool(too_small or too_long)


_ATTRIBUTES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_UPPER = np.triu_indices(3)


def _attributes(matrix: Floats) -> dict[str, str]:
    """Return the attributes of an inertia in a URDF."""
    return dict(zip(_ATTRIBUTES, map(str, matrix[_UPPER].tolist()), strict=True))


def _convert_meshes(
    root: Element, path: Path, folder: Path, find: FindPackage
) -> list[str]:
    """Copy or convert the meshes of a URDF into a folder; a visual per colour refers to them.

    Return the names of textures and textured meshes.
    """
    folder.mkdir()
    textured: list[str] = []
    known: dict[tuple[Path, str], list[_Part]] = {}
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            shape.attrib.pop("name", None)  # MuJoCo takes no name twice
            for material in shape.findall("material"):
                textured += [t.get("filename", "") for t in material.iter("texture")]
                _remove(material, "texture")
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            source = _mesh_file(mesh.get("filename", ""), path, find)
            key = (source, shape.tag)
            if key not in known:
                stem = f"{shape.tag}_{len(known)}_{re.sub(r'[^A-Za-z0-9]+', '_', source.stem)}"
                known[key] = _convert_mesh(source, folder / stem, shape.tag == "visual")
                if any(part.is_textured for part in known[key]):
                    textured.append(source.name)
            link.remove(shape)
            for part in known[key]:
                mesh.set("filename", f"{MESHES}/{part.file.name}")
                link.append(_coloured(shape, part))
    return list(dict.fromkeys(textured))


def _coloured(shape: Element, part: _Part) -> Element:
    """Return a copy of a shape in the colour of a part of its mesh."""
    copy = deepcopy(shape)
    if part.rgba is not None:
        _remove(copy, "material")
        material = SubElement(copy, "material", name=part.file.stem)
        SubElement(material, "color", rgba=part.rgba)
    return copy


def _mesh_file(name: str, path: Path, find: FindPackage) -> Path:
    """Return the file of a mesh of a URDF."""
    scheme, separator, place = name.replace("\\", "/").rpartition("://")
    if separator:
        place = unquote(place)
    if scheme in ("package", "model"):
        file = _package_file(place, path, find)
    else:
        if re.match(r"/[A-Za-z]:/", place):
            place = place[1:]
        file = path.parent / place
    if not file.is_file():
        raise UserError(f"Mesh {name!r} of {path} is not found: there is no {file}.")
    return file.resolve()


def _package_file(place: str, path: Path, find: FindPackage) -> Path:
    """Return a file of a package from its place after the scheme."""
    package, _, inside = place.partition("/")
    # A copied folder may have lost its package.xml and its name.
    for folder in path.absolute().parents[:LEVELS]:
        if (folder / inside).is_file():
            return folder / inside
    return find(package) / inside


def _convert_mesh(source: Path, target: Path, colours: bool) -> list[_Part]:
    """Copy a binary STL file; split another mesh by its colours, which collisions do without."""
    refuse_pointer(source)
    if _is_binary_stl(source):
        return [_Part(Path(shutil.copyfile(source, target.with_suffix(".stl"))), None)]
    with packages_of("urdf", f"The mesh {source}"):
        import trimesh

        import_module("collada")  # with which trimesh reads COLLADA
    parts = []
    remedy = "Give a mesh that trimesh reads, such as STL, OBJ or COLLADA."
    with reading(source, remedy):
        groups: dict[str | None, list[Any]] = {}
        for mesh in trimesh.load_scene(source).dump():
            if isinstance(mesh, trimesh.Trimesh):
                units = mesh.metadata.get("units", "")
                metres = re.match(r"([\d.eE+-]+) \* meters", units)
                if metres:
                    mesh.apply_scale(float(metres[1]))
                rgba = _rgba(mesh) if colours else None
                groups.setdefault(rgba, []).append(mesh)
        if not groups:
            raise ValueError("it has no faces")
        for i, (rgba, meshes) in enumerate(groups.items()):
            whole: Any = trimesh.util.concatenate(meshes)
            suffix = ".stl" if len(whole.faces) <= MOST_STL_FACES else ".obj"
            file = target.with_name(f"{target.name}_{i}{suffix}")
            whole.export(file)
            is_textured = colours and any(_image(mesh) is not None for mesh in meshes)
            parts.append(_Part(file, rgba, is_textured))
    return parts


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
