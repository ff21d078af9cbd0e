"""MJCF files of robots and objects: read, checked, and reduced to what a scene simulates."""

import re
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from mujoco import (
    MjData,
    MjsGeom,
    MjsJoint,
    MjSpec,
    mj_kinematics,
    mjtBias,
    mjtGeom,
    mjtJoint,
    mjtLimited,
    mjtOrientation,
    mju_axisAngle2Quat,
    mju_getXMLDependencies,
    mju_mulQuat,
    mju_quat2Mat,
)
from numpy.linalg import norm

from knowarm.arrays import Floats
from knowarm.errors import UserError, shell_command
from knowarm.fence import fenced
from knowarm.reading import one_line, reading, refuse_pointer
from knowarm.world.description import HOW_TO_GET, menagerie_folder

PACKAGE = Path(__file__).parents[2]
"""The installed package, whose own files are trusted."""


def read_mjcf(path: Path, owner: str, xml: str | None = None) -> MjSpec:
    """Read an MJCF file, or its text; messages name the owner of it ("Robot 'irb120'")."""
    if xml is not None:
        return MjSpec.from_string(xml)
    remedy = " Correct the path; that of a TOML file starts from its folder."
    if path.is_relative_to(menagerie_folder()):
        remedy = f" To get it: {HOW_TO_GET}."
    with reading(path, "Give the path of an MJCF file."):
        if not path.is_file():
            raise UserError(
                f"{owner}: mjcf is {str(path)!r}, and there is no such file.{remedy}"
            )
    if path.suffix in (".urdf", ".xacro"):
        raise UserError(
            f"{owner}: mjcf is {str(path)!r}, which is no MJCF file. Convert it: "
            f"{shell_command('doctor', '--robot', path, '--write', 'ROBOT.toml')}"
        )
    try:
        if not path.is_relative_to(PACKAGE):
            fenced(_compile, path)
        return MjSpec.from_file(str(path))
    except UserError:
        raise
    except ValueError as error:
        raise UserError(
            f"{owner}: mjcf {str(path)!r} does not compile: {one_line(error)}. Correct the file; "
            f"`python -m mujoco.viewer --mjcf={shlex.quote(str(path))}` shows the same error."
        ) from None


def drawn(spec: MjSpec) -> MjData:
    """Compile a model; return its bodies as they are drawn, with the compiled model."""
    model = spec.compile()
    data = MjData(model)
    mj_kinematics(model, data)
    return data


def _compile(path: Path) -> None:
    """Compile an MJCF file whose parts are files: no FIFOs, and no pointers of Git LFS."""
    refuse_pointer(path)
    for name in map(Path, mju_getXMLDependencies(str(path))):
        with reading(name, "Restore the file."):
            refuse_pointer(name)
    MjSpec.from_file(str(path)).compile()


_SIZES = "njmax nconmax memory nuserdata"
_DEMO_ELEMENTS = (
    "keys actuators sensors equalities tendons pairs excludes lights cameras"
)


def strip(part: MjSpec, scene: MjSpec) -> None:
    """Delete what a file contains for its own demo and not for the scene it is attached to."""
    # Of options and sizes, those that differ would be left out with a warning.
    part.option = scene.option
    for size in _SIZES.split():
        setattr(part, size, getattr(scene, size))
    for kind in _DEMO_ELEMENTS.split():
        for element in list(getattr(part, kind)):
            part.delete(element)


def take_ranges(part: MjSpec, joints: Iterable[str]) -> None:
    """Give joints without a range that of the positions that their actuator is given."""
    for actuator in part.actuators:
        is_position = actuator.biastype == mjtBias.mjBIAS_AFFINE
        low, high = actuator.ctrlrange
        if actuator.target not in joints or not is_position or low >= high:
            continue
        joint = part.joint(actuator.target)
        if joint is not None and joint.range[0] >= joint.range[1]:
            set_range(part, joint, low, high)


def set_range(
    part: MjSpec,
    joint: MjsJoint,
    low: float,
    high: float,
) -> None:
    """Limit a joint of a file to a range [rad] (slides: [m])."""
    joint.range = [low, high]
    if part.compiler.degree and joint.type == mjtJoint.mjJNT_HINGE:
        joint.range = np.degrees(joint.range)
    joint.limited = mjtLimited.mjLIMITED_TRUE


FLOORS = (mjtGeom.mjGEOM_PLANE, mjtGeom.mjGEOM_HFIELD)
FURNITURE = re.compile(
    "(?<![a-z])(table|desk|counter|bench|shelf|wall|floor|ground|ceiling|cupboard|cabinet)"
    "(top|leg|plate|board|surface)?s?(?![a-z])"
)
"""Names, by words, of what stands around a robot."""

FURNITURE_M = 0.5
"""Two sides of a box in the world from which it is no part of an arm [m]."""


def surroundings(part: MjSpec, joints: Iterable[str]) -> list[Any]:
    """Return the floors, furniture and top-level bodies of a robot's file without its joints.

    Other geoms of the world belong to the robot: a file made from URDF has its base there.
    """
    world = part.worldbody
    elements: list[Any] = [
        geom for geom in world.geoms if geom.type in FLOORS or _is_furniture(geom)
    ]
    for body in world.bodies:
        carried = [joint.name for joint in body.find_all("joint")]
        if set(joints).isdisjoint(carried):
            elements.append(body)
    return elements


def _is_furniture(geom: MjsGeom) -> bool:
    """Return whether a geom of the world is named as furniture, or is a box as wide as a table."""
    if FURNITURE.search(f"{geom.name} {geom.meshname}".lower()):
        return True
    is_box = geom.type == mjtGeom.mjGEOM_BOX
    sides = 2 * np.sort(geom.size)
    return bool(is_box and sides[1] >= FURNITURE_M)


def turn_about_z(degrees: float) -> list[float]:
    """Return the quaternion of a rotation about z, wxyz."""
    half = np.radians(degrees) / 2
    return [np.cos(half), 0, 0, np.sin(half)]


def _rotation(quaternion: Floats) -> Floats:
    """Return the rotation matrix of a quaternion, (3, 3)."""
    matrix = np.zeros(9)
    mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def hold(part: MjSpec, joint: MjsJoint, value: float, owner: str) -> None:
    """Move a joint's body to its pose at a joint value, so that the joint can be removed."""
    body = joint.parent
    in_degrees = part.compiler.degree
    is_hinge = joint.type == mjtJoint.mjJNT_HINGE
    reference = joint.ref
    if is_hinge and in_degrees:
        reference = np.radians(reference)
    value -= reference
    if value == 0:
        return
    quaternion_type = mjtOrientation.mjORIENTATION_QUAT
    if body.alt.type != quaternion_type:
        sequence = part.compiler.eulerseq
        body.quat = MjSpec.resolve_orientation(in_degrees, sequence, body.alt)
        body.alt.type = quaternion_type
    rotation = _rotation(body.quat)
    axis = np.asarray(joint.axis) / norm(joint.axis)
    if joint.type == mjtJoint.mjJNT_SLIDE:
        body.pos = body.pos + rotation @ axis * value
    elif is_hinge:
        turn = np.zeros(4)
        mju_axisAngle2Quat(turn, axis, value)
        arm = np.asarray(joint.pos)
        body.pos = body.pos + rotation @ (arm - _rotation(turn) @ arm)
        turned = np.zeros(4)
        mju_mulQuat(turned, body.quat, turn)
        body.quat = turned
    else:
        raise UserError(
            f"{owner}: held_joints can hold hinges and slides; {joint.name!r} is neither."
        )


def hide_sites(part: MjSpec) -> None:
    """Move the sites to group 5, which no image shows and viewers show on request."""
    for site in part.sites:
        site.group = 5


def check_names(
    owner: str,
    field: str,
    names: Iterable[str],
    mjcf: Path,
    kind: str,
    elements: Iterable[Any],
    remedy: str = "",
) -> None:
    """Check that all names of a field are among the elements of an MJCF file."""
    existing = {element.name for element in elements if element.name}
    listed = ", ".join(sorted(existing)) or "none"
    for name in names:
        if name not in existing:
            raise UserError(
                f"{owner}: {field} names {name!r}, which {mjcf.name} does not have. Its {kind}: "
                f"{listed}.{remedy}"
            )
