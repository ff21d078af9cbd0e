"""URDF and xacro files, converted to an MJCF file with its meshes beside it."""

import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from urllib.parse import unquote
from xml.etree import ElementTree

import mujoco
import numpy as np

from knowarm.arrays import Floats
from knowarm.errors import UserError, packages_of
from knowarm.private_apis import xacro_packages
from knowarm.reading import one_line, read_text, reading, writing

MODEL_SUFFIXES = (".xml", ".mjcf", ".urdf", ".xacro")
"""Files with these suffixes hold a bare model, for which a description is drafted."""

XACRO, MESHES = ".xacro", "meshes"
LEVELS = 5  # Folders above a file in which and beside which its packages are searched
MOST_STL_FACES = 200_000  # More are not read by MuJoCo from an STL file
VISUAL_GROUP, COLLISION_GROUP = 1, 3  # MuJoCo's of a URDF's visuals, and one that is not drawn
LEAST_KG, LEAST_INERTIA = 1e-4, 1e-6  # Of a link that moves [kg], [kg m^2]
ROUNDING = 1e-4  # Relative error of inertias as they are written
COMPILER = {
    "discardvisual": "false",
    "fusestatic": "false",
    "strippath": "false",
}
"""Options of MuJoCo's compiler that keep visuals and fixed links."""


class _Part(NamedTuple):
    """One colour of a mesh."""

    file: Path
    rgba: str | None  # None: the file has no colours


def as_mjcf(
    path: Path, folder: Path, *, arguments: Sequence[str] = (), packages: Sequence[str] = ()
) -> tuple[Path, str]:
    """Return the MJCF file of a robot's file, and what was done to convert it ("" for MJCF).

    A URDF or xacro file is converted into a new ``folder``. ``arguments`` of xacro have the form
    ``name:=value``, and ``packages`` that its meshes and includes lie in ``name=folder``.

    Raises:
        UserError: a package, mesh or library is missing, or the file is invalid.
    """
    given = {name: Path(each) for name, each in _pairs("--package", packages, "=").items()}
    find = partial(_find_package, path, given)
    root = None
    if path.suffix == XACRO:
        root = _expand(path, find, _pairs("--xacro", arguments, ":="))
    elif arguments:
        raise UserError(f"--xacro needs a {XACRO} file, got {path}.")
    elif path.is_file():
        text = read_text(path, remedy="Give a URDF, xacro or MJCF file.")
        try:
            root = ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            raise UserError(f"{path} is not valid XML: {one_line(error)}.") from None
    if root is None or root.tag != "robot":
        return path, ""
    if folder.exists():
        raise UserError(f"The folder {folder} for the converted model exists; remove or rename it.")
    notes = [f"converted from {path.name}", *_repair_inertias(root)]
    name = path.with_suffix("").stem + ".xml"
    with TemporaryDirectory() as temporary:
        file = Path(temporary) / name
        _compiler(root)
        _convert_meshes(root, path, file.with_name(MESHES), find)
        ElementTree.ElementTree(root).write(file)
        try:
            spec = mujoco.MjSpec.from_file(str(file))
            for mesh in spec.meshes:  # a visual has no mass, and may have no volume
                if mesh.name.startswith("visual"):
                    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            geoms = [geom for body in spec.bodies for geom in body.geoms]
            if any(geom.group == VISUAL_GROUP for geom in geoms):
                for geom in geoms:  # images show what a viewer of URDF does, safety boxes not
                    geom.group = geom.group or COLLISION_GROUP
            for body in spec.bodies[1:]:  # frames without shape, such as tool0
                if not (list(body.geoms) or list(body.joints) or list(body.bodies)):
                    body.add_site(name=body.name)
            spec.compile()
            file.write_text(spec.to_xml(), encoding="utf-8")
        except (ValueError, mujoco.FatalError) as error:
            raise UserError(f"{path} cannot be converted: {one_line(error)}. Correct it.") from None
        with writing(folder):
            shutil.copytree(temporary, folder)
    return folder / name, "; ".join(notes)


def _pairs(option: str, values: Sequence[str], sign: str) -> dict[str, str]:
    """Read the values of an option by name."""
    pairs = [value.partition(sign) for value in values]
    for (name, found, _), value in zip(pairs, values, strict=True):
        if not name or not found:
            raise UserError(f"{option} must have the form name{sign}value, got {value!r}.")
    return {name: value for name, _, value in pairs}


def _expand(
    path: Path, find: Callable[[str], Path], arguments: Mapping[str, str]
) -> ElementTree.Element:
    """Expand a xacro file."""
    with packages_of("urdf", f"The xacro file {path}"):
        import xacro
    remedy = "Give a xacro file, and --xacro name:=value if it requires arguments."
    with reading(path, remedy), xacro_packages(lambda name: str(find(name))):
        try:
            document = xacro.process_file(str(path), mappings=dict(arguments))
        except xacro.XacroException as error:
            raise error.exc if isinstance(error.exc, UserError) else error from None
        return ElementTree.fromstring(document.toxml())


def _find_package(path: Path, given: Mapping[str, Path], name: str) -> Path:
    """Return the folder of a ROS package: given, or above the file or beside such a folder."""
    if name in given:
        return given[name]
    for above in path.absolute().parents[:LEVELS]:
        for folder in (above, *sorted(each for each in above.iterdir() if each.is_dir())):
            if name == _package_name(folder):
                return folder
    raise UserError(
        f"Package {name!r} of {path} is not found in the {LEVELS} folders above it, nor beside "
        f"them. Give its folder: --package {name}=FOLDER."
    )


def _package_name(folder: Path) -> str:
    """Return the name in the package.xml of a folder, else the folder's."""
    try:
        found = ElementTree.parse(folder / "package.xml").findtext("name")
    except (OSError, ElementTree.ParseError):
        found = None
    return (found or folder.name).strip()


def _compiler(root: ElementTree.Element) -> None:
    """Set the options of MuJoCo's compiler in a URDF."""
    extension = root.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(root, "mujoco")
    for old in extension.findall("compiler"):
        extension.remove(old)
    ElementTree.SubElement(extension, "compiler", COMPILER)


def _repair_inertias(root: ElementTree.Element) -> Iterator[str]:
    """Make the inertias of a URDF possible; name the links that move and whose inertia is not."""
    moved = {
        child.get("link")
        for joint in root.iter("joint")
        if joint.get("type") != "fixed"
        for child in joint.findall("child")
    }
    missing, repaired = [], []
    for link in root.findall("link"):
        name = link.get("name", "")
        inertia, mass = link.find("inertial/inertia"), link.find("inertial/mass")
        if inertia is None or mass is None:
            missing += [name] * (name in moved)
            if link.find("collision") is None:
                part = ElementTree.SubElement(link, "inertial")
                ElementTree.SubElement(part, "mass", value=str(LEAST_KG))
                diagonal = np.diag(3 * [LEAST_INERTIA])
                ElementTree.SubElement(part, "inertia", _six(diagonal))
            continue
        matrix = np.zeros((3, 3))
        matrix[_UPPER] = [float(inertia.get(key, 0)) for key in _SIX]
        values, axes = np.linalg.eigh(matrix + np.triu(matrix, 1).T)
        heavy = float(mass.get("value", 0)) >= LEAST_KG
        if not heavy or values[0] <= 0 or values[0] + values[1] < values[2] * (1 - ROUNDING):
            repaired += [name] * (name in moved)
            values = np.maximum(values, LEAST_INERTIA)
            if values[0] + values[1] < values[2]:
                values[:] = values.mean()  # as MuJoCo's balanceinertia does
        values[2] = min(values[2], (values[0] + values[1]) * (1 - ROUNDING))
        inertia.attrib.update(_six(axes @ np.diag(values) @ axes.T))
        mass.set("value", str(max(float(mass.get("value", 0)), LEAST_KG)))
    if missing:
        yield f"inertia from shapes or least values, as the file has none: {', '.join(missing)}"
    if repaired:
        yield f"impossible inertia repaired: {', '.join(repaired)}"


_SIX, _UPPER = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), np.triu_indices(3)


def _six(matrix: Floats) -> dict[str, str]:
    """Return the attributes of an inertia in a URDF."""
    return dict(zip(_SIX, map(str, matrix[_UPPER].tolist()), strict=True))


def _convert_meshes(
    root: ElementTree.Element, path: Path, folder: Path, find: Callable[[str], Path]
) -> None:
    """Copy or convert the meshes of a URDF into a folder; a visual per colour refers to them."""
    folder.mkdir()
    known: dict[tuple[Path, str], list[_Part]] = {}
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            shape.attrib.pop("name", None)  # MuJoCo takes no name twice
            for material in shape.findall("material"):
                for texture in material.findall("texture"):
                    material.remove(texture)
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            source = _mesh_file(mesh.get("filename", ""), path, find)
            key = (source, shape.tag)
            if key not in known:
                stem = f"{shape.tag}_{len(known)}_{re.sub(r'[^A-Za-z0-9]+', '_', source.stem)}"
                known[key] = _convert_mesh(source, folder / stem, shape.tag == "visual")
            link.remove(shape)
            for part in known[key]:
                mesh.set("filename", f"{MESHES}/{part.file.name}")
                copy = ElementTree.fromstring(ElementTree.tostring(shape))
                if part.rgba is not None:
                    for old in copy.findall("material"):
                        copy.remove(old)
                    material = ElementTree.SubElement(copy, "material", name=part.file.stem)
                    ElementTree.SubElement(material, "color", rgba=part.rgba)
                link.append(copy)


def _mesh_file(name: str, path: Path, find: Callable[[str], Path]) -> Path:
    """Return the file of a mesh of a URDF."""
    scheme, found, place = name.replace("\\", "/").rpartition("://")
    if scheme in ("package", "model"):
        package, _, inside = unquote(place).partition("/")
        # A copied folder may have lost its package.xml and its name.
        above = [folder / inside for folder in path.absolute().parents[:LEVELS]]
        own = next((file for file in above if file.is_file()), None)
        file = own or find(package) / inside
    else:
        place = unquote(place) if found else place
        place = place[1:] if re.match(r"/[A-Za-z]:/", place) else place
        file = path.parent / place
    if not file.is_file():
        raise UserError(f"Mesh {name!r} of {path} is not found: there is no {file}.")
    return file.resolve()


def _convert_mesh(source: Path, target: Path, colours: bool) -> list[_Part]:
    """Copy a binary STL file; split another mesh by its colours, which collisions do without."""
    with source.open("rb") as file:
        faces = int.from_bytes(file.read(84)[80:], "little")
    binary = source.suffix.lower() == ".stl" and source.stat().st_size == 84 + 50 * faces
    if binary and 0 < faces <= MOST_STL_FACES:
        return [_Part(Path(shutil.copyfile(source, target.with_suffix(".stl"))), None)]
    with packages_of("urdf", f"The mesh {source}"):
        import trimesh

        import_module("collada")  # with which trimesh reads COLLADA
    with reading(source, "Give a mesh that trimesh reads, such as STL, OBJ or COLLADA."):
        meshes = [m for m in trimesh.load_scene(source).dump() if isinstance(m, trimesh.Trimesh)]
        groups: dict[str | None, list[Any]] = {}
        for mesh in meshes:
            metres = re.match(r"([\d.eE+-]+) \* meters", mesh.metadata.get("units", ""))
            mesh.apply_scale(float(metres[1]) if metres else 1.0)
            groups.setdefault(_rgba(mesh) if colours else None, []).append(mesh)
        if not groups:
            raise ValueError("it has no faces")
        parts = []
        for i, (rgba, some) in enumerate(groups.items()):
            whole: Any = trimesh.util.concatenate(some)
            suffix = ".stl" if len(whole.faces) <= MOST_STL_FACES else ".obj"
            part = target.with_name(f"{target.name}_{i}{suffix}")
            whole.export(part)
            parts.append(_Part(part, rgba))
    return parts


def _rgba(mesh: Any) -> str | None:
    """Return the mean colour of a mesh in URDF's notation, or None if it has none."""
    if not mesh.visual.defined:
        return None
    material = getattr(mesh.visual, "material", None)
    image = next(
        (each for key in ("image", "baseColorTexture") if (each := getattr(material, key, None))),
        None,
    )
    if image is not None:
        colour = np.asarray(image.convert("RGBA"), float).reshape(-1, 4).mean(axis=0)
    else:
        colour = np.asarray(mesh.visual.main_color if material is None else material.main_color)
    return " ".join(f"{value:.3g}" for value in colour / 255)
