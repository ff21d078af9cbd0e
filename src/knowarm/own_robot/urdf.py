"""URDF and xacro files, converted to an MJCF file with its meshes beside it."""

import math
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from mujoco import MjsBody, MjSpec, mjtMeshInertia

from knowarm.errors import UserError, packages_of
from knowarm.fence import fenced
from knowarm.own_robot.urdf_meshes import MESHES, convert_meshes, remove_children
from knowarm.private_apis import xacro_packages
from knowarm.reading import (
    new_folder,
    one_line,
    read_text,
    reading,
    refuse_pointer,
    writing,
)

MODEL_SUFFIXES = (".xml", ".mjcf", ".urdf", ".xacro")
"""Files with these suffixes hold a bare model, for which a description is drafted."""

XACRO = ".xacro"
XACRO_MARKS = re.compile(r"[/.]ros\.org/[^\"]*xacro|\$[{(]")
"""Of the namespace of xacro's elements, where there are any, and of its expressions."""

SIMULATION = ("gazebo", "transmission", "ros2_control")
"""Elements that describe no arm, but may name packages as xacro does."""

LEVELS = 5  # Folders above a file in which and beside which its packages are searched
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


def as_mjcf(
    path: Path,
    folder: Path,
    *,
    arguments: Sequence[str] = (),
    packages: Sequence[str] = (),
) -> tuple[Path, str]:
    """Return the MJCF file of a robot's file, and what was done to convert it ("" for MJCF).

    A URDF or xacro file is converted into a new ``folder``, of which an error leaves a part.
    ``arguments`` of xacro have the form ``name:=value``, and ``packages`` that its meshes and
    includes lie in ``name=folder``.

    Raises:
        UserError: a package, mesh or library is missing, or the file is invalid.
    """
    refuse_pointer(path)
    ros = _Packages(path, packages)
    with reading(path, "It cannot be converted: correct it."):
        file = folder / path.with_suffix("").with_suffix(".xml").name
        note = fenced(_convert, ros, arguments, file)
    return (file if note else path), note


def keep_converted(model: Path, folder: Path) -> None:
    """Copy a converted model with its folder to a new one."""
    with writing(folder), new_folder(folder) as made:
        shutil.copytree(model.parent, made, dirs_exist_ok=True)


def _convert(ros: "_Packages", arguments: Sequence[str], file: Path) -> str:
    """Write the MJCF of a URDF or xacro file; return what was done, "" for another file."""
    path = ros.path
    root = None
    is_xacro = path.suffix.lower() == XACRO
    if not is_xacro and path.is_file():
        text = read_text(path, remedy="Give a URDF, xacro or MJCF file.")
        try:
            root = ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            cause = one_line(error)
            if re.search("^<<<<<<< ", text, re.MULTILINE):
                cause += "; it holds the markers of an unfinished merge (<<<<<<<)"
            raise UserError(f"{path} is not valid XML: {cause}.") from None
        _refuse_others(root, path)
        for tag in SIMULATION:
            remove_children(root, tag)
    if is_xacro or (root is not None and _is_xacro(root)):
        root = _expand(ros, _pairs("--xacro", arguments, ":="))
    elif arguments:
        raise UserError(f"--xacro needs a {XACRO} file, got {path}.")
    if root is None or root.tag != "robot":
        return ""
    if root.find("link") is None:
        raise UserError(
            f"{path} describes no links. Give the robot's URDF: an SRDF only groups its joints, "
            "and a xacro file of macros is included by another."
        )
    softened = _set_limits(root, path)
    remove_children(root, "mujoco")
    SubElement(SubElement(root, "mujoco"), "compiler", COMPILER)
    textured = convert_meshes(root, file.with_name(MESHES), ros.mesh)
    ElementTree.ElementTree(root).write(file)
    spec = MjSpec.from_file(str(file))
    missing, repaired = _repair_inertias(spec)
    file.write_text(_compile(spec), encoding="utf-8")
    notes = [f"converted from {path.name}"]
    for what, names in (
        ("inertia from shapes or least values, as the file has none: ", missing),
        ("impossible inertia repaired: ", repaired),
        ("soft limits taken for ", softened),
        ("textures drawn as one colour: ", textured),
        ("packages known by their files' paths only: ", ros.guessed),
    ):
        if names:
            notes.append(what + ", ".join(names))
    return "; ".join(notes)


def _compile(spec: MjSpec) -> str:
    """Return the MJCF of a URDF whose meshes MuJoCo reads."""
    for mesh in spec.meshes:  # a visual has no mass, and may have no volume
        if mesh.name.startswith("visual"):
            mesh.inertia = mjtMeshInertia.mjMESH_INERTIA_SHELL
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


def _refuse_others(root: Element, path: Path) -> None:
    """Refuse XML of another kind."""
    if root.tag not in ("robot", "mujoco"):
        raise UserError(
            f"{path} holds <{root.tag}>, and neither a URDF (<robot>) nor a whole MJCF file "
            "(<mujoco>). Give such a file, or convert it."
        )


def _is_xacro(root: Element) -> bool:
    """Return whether a robot's XML has xacro's elements or expressions."""
    text = ElementTree.tostring(root, encoding="unicode")
    return root.tag == "robot" and bool(XACRO_MARKS.search(text))


class _Packages:
    """Files of the ROS packages that a robot's file names: given, above it or beside those."""

    def __init__(self, path: Path, given: Sequence[str]) -> None:
        self.path = path
        self.above = path.absolute().parents[:LEVELS]
        self.given: dict[str, Path] = {}
        self.guessed: list[str] = []  # Packages that only a path in them tells
        for name, text in _pairs("--package", given, "=").items():
            folder = Path(text).expanduser().resolve()
            if not folder.is_dir():
                raise UserError(
                    f"--package {name}={text}: there is no folder {folder}. Give that of the "
                    "package."
                )
            self.given[name] = folder

    def folder(self, name: str, inside: str = "") -> Path:
        """Return the folder of a package, from which ``inside`` leads to a file of it."""
        if name in self.given:
            return self.given[name]
        for above in self.above:
            beside = sorted(entry for entry in above.iterdir() if entry.is_dir())
            for folder in (above, *beside):
                if name == _package_name(folder):
                    self.given[name] = folder
                    return folder
        for above in self.above:  # a copied folder may have lost package.xml and name
            if inside and (above / inside).is_file():
                self.given[name] = above
                self.guessed.append(f"{name} is {above}")
                return above
        wanted = f", which holds {inside}" if inside else ""
        raise UserError(
            f"Package {name!r} of {self.path} is not found in the {LEVELS} folders above it, nor "
            f"beside them. Give its folder{wanted}: --package {name}=FOLDER."
        )

    def mesh(self, name: str) -> Path:
        """Return the file of a mesh."""
        scheme, separator, place = name.replace("\\", "/").rpartition("://")
        if separator:
            place = unquote(place)
        if scheme in ("package", "model"):
            package, _, inside = place.partition("/")
            file = self.folder(package, inside) / inside
        else:
            if re.match(r"/[A-Za-z]:/", place):
                place = place[1:]
            file = self.path.parent / place
        if not file.is_file():
            raise UserError(
                f"Mesh {name!r} of {self.path} is not found: there is no {file}."
            )
        return file.resolve()


def _package_name(folder: Path) -> str:
    """Return the name in the package.xml of a folder, else the folder's."""
    try:
        name = ElementTree.parse(folder / "package.xml").findtext("name")
    except (OSError, ElementTree.ParseError):
        name = None
    return (name or folder.name).strip()


def _expand(ros: _Packages, arguments: dict[str, str]) -> Element:
    """Expand a xacro file."""
    path = ros.path
    with packages_of("urdf", f"The xacro file {path}"):
        import xacro
    remedy = "Give a xacro file, and --xacro name:=value if it requires arguments."
    with reading(path, remedy), xacro_packages(lambda name: str(ros.folder(name))):
        try:
            document = xacro.process_file(str(path.absolute()), mappings=arguments)
        except Exception as error:  # of the file or one that it includes
            cause = getattr(error, "exc", None)
            if isinstance(cause, UserError):
                raise cause from None
            included = Path(xacro.filestack[-1])
            refuse_pointer(included)
            if included == path.absolute():
                raise
            raise ValueError(f"{included}: {one_line(error)}") from error
        return ElementTree.fromstring(document.toxml())


SOFT_LIMITS = ("soft_lower_limit", "soft_upper_limit")
"""Attributes of a joint's safety_controller."""


def _set_limits(root: Element, path: Path) -> list[str]:
    """Take the soft limits of joints, which a controller enforces; return those joints.

    Raises:
        UserError: a lower limit is above its upper one.
    """
    softened = []
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        limit = joint.find("limit")
        if limit is None or joint.get("type") not in ("revolute", "prismatic"):
            continue
        low, high = _numbers(limit, ("lower", "upper"), name, path)
        if low > high:
            raise UserError(
                f"Joint {name!r} of {path} has a lower limit of {low:g} and an upper one of "
                f"{high:g}. Exchange or correct them in the file."
            )
        soft = joint.find("safety_controller")
        if soft is None or not set(soft.attrib) >= {*SOFT_LIMITS}:
            continue
        soft_low, soft_high = _numbers(soft, SOFT_LIMITS, name, path)
        ends = (max(low, soft_low), min(high, soft_high))
        if ends != (low, high) and ends[0] < ends[1]:
            limit.attrib.update(lower=str(ends[0]), upper=str(ends[1]))
            softened.append(name)
    return softened


def _numbers(
    element: Element, keys: Sequence[str], joint: str, path: Path
) -> list[float]:
    """Return numbers among the attributes of a joint's element, by default 0."""
    numbers = []
    for key in keys:
        text = element.get(key, "0")
        try:
            number = float(text)
            if math.isnan(number):
                raise ValueError
        except ValueError:
            raise UserError(
                f"Joint {joint!r} of {path}: {key} is {text!r}, which is no number. Correct the "
                "file."
            ) from None
        numbers.append(number)
    return numbers


def _repair_inertias(spec: MjSpec) -> tuple[list[str], list[str]]:
    """Make the inertias of a URDF possible.

    Return the links that move and have none, and those whose inertia was not possible.
    """
    missing = []
    repaired = []
    for body in spec.bodies[1:]:
        moves = bool(list(body.joints))
        if not body.explicitinertial:
            if moves:
                missing.append(body.name)
            if all(geom.group == VISUAL_GROUP for geom in body.geoms):
                body.explicitinertial = True
                body.ipos = np.zeros(3)
                body.mass = LEAST_KG
                body.inertia = np.full(3, LEAST_INERTIA)
        elif _repair_inertia(body) and moves:
            repaired.append(body.name)
    return missing, repaired


def _repair_inertia(body: MjsBody) -> bool:
    """Make an inertia possible; return whether it was not."""
    full = np.nan_to_num(body.fullinertia)  # MuJoCo reads no zeros
    matrix = np.diag(full[:3])
    matrix[BELOW] = full[3:]
    values, axes = np.linalg.eigh(matrix)
    too_small = body.mass < LEAST_KG or values[0] <= 0
    too_long = values[:2].sum() < values[2] * (1 - ROUNDING)
    if too_small or too_long:
        values = np.maximum(values, LEAST_INERTIA)
        if values[:2].sum() < values[2]:
            values[:] = values.mean()  # as MuJoCo's balanceinertia does
    values[2] = min(values[2], values[:2].sum() * (1 - ROUNDING))
    matrix = axes @ np.diag(values) @ axes.T
    body.fullinertia = [*matrix.diagonal(), *matrix[BELOW]]
    body.mass = max(body.mass, LEAST_KG)
    return bool(too_small or too_long)


BELOW = np.tril_indices(3, -1)
"""Rows and columns of a matrix below its diagonal."""
