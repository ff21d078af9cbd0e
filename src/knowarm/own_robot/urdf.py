"""URDF and xacro files, converted to an MJCF file with its meshes beside it."""

import math
import re
import shutil
from collections.abc import Sequence
from copy import deepcopy
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import unquote
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from mujoco import MjsBody, MjSpec, mjtMeshInertia

from knowarm.errors import UserError, packages_of
from knowarm.fence import fenced
from knowarm.private_apis import xacro_packages
from knowarm.reading import (
    one_line,
    read_bytes,
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
    refuse_pointer(path)
    ros = _Packages(path, packages)
    name = path.with_suffix("").stem + ".xml"
    with TemporaryDirectory() as temporary:
        try:
            note = fenced(_convert, ros, arguments, Path(temporary) / name)
        except UserError:
            raise
        except ValueError as error:
            raise UserError(
                f"{path} cannot be converted: {one_line(error)}. Correct it."
            ) from None
        if not note:
            return path, ""
        if folder.exists():
            raise UserError(
                f"The folder {folder} for the converted model exists; remove or rename it."
            )
        with writing(folder):
            shutil.copytree(temporary, folder)
    return folder / name, note


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
    _remove(root, "mujoco")
    SubElement(SubElement(root, "mujoco"), "compiler", COMPILER)
    textured = _convert_meshes(root, file.with_name(MESHES), ros)
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
