"""Scene: the compiled MuJoCo model of a robot and its targets, with the indices of its parts."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path

import numpy as np
from mujoco import (
    FatalError,
    MjData,
    MjModel,
    mj_camlight,
    mj_kinematics,
    mjtSameFrame,
    mju_mulQuat,
    mju_normalize4,
)
from numpy.typing import NDArray

from knowarm.arrays import Floats, Floats32, Indices, Mask
from knowarm.errors import UserError
from knowarm.reading import one_line
from knowarm.world.description import SUFFIX
from knowarm.world.objects import find_targets
from knowarm.world.objects.target import Target
from knowarm.world.robots import find_robot
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.compose import CAMERA, DISTRACTOR, ROBOT_PREFIX, compose
from knowarm.world.scene.mjcf import turn_about_z

# Range of hinges that have none of their own [rad]
ENDLESS_RANGE_RAD = (-2 * np.pi, 2 * np.pi)


@dataclass(frozen=True)
class Fingers:
    """Two fingers that move together: the last joint of a scene, 0 where they are open."""

    closed_m: float  # Way of the first from open to closed
    force_n: float  # Largest force of each


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Scene:
    """A compiled model and the indices of its parts.

    Dimensions: J joints, K targets, C colours, D distractors, G geoms.
    """

    # Robot, table, floor, lights, the policy's camera, and the targets as mocap bodies
    model: MjModel
    robot: Robot  # Description of the robot
    targets: tuple[Target, ...]  # Descriptions of the targets
    joint_names: tuple[str, ...]  # Names of the joints that the agent moves, (J,)
    qpos_index: Indices  # Index in qpos of each joint, (J,)
    joint_lower: Floats  # Lower limit of each joint [rad], (J,)
    joint_upper: Floats  # Upper limit of each joint [rad], (J,)
    home: Floats  # Start angle of each joint before the random offset [rad], (J,)
    tcp_site: int  # Id of the site at the tool centre point (TCP)
    camera: int  # Id of the policy's camera
    camera_position: Floats  # Position of the camera, world [m], (3,)
    # Rotation from camera (x right, y up, z backward) to world, (3, 3)
    camera_matrix: Floats
    geom_target: Indices  # Index of the target each geom belongs to, -1 for none, (G,)
    geom_coloured: Mask  # Whether a geom has its target's colour, (G,)
    # RGB by target and colour, (K, C, 3); padded with the first colour
    target_colours: Floats32
    surface_geoms: tuple[int, ...]  # Ids of floor and, if there is one, table top
    distractor_geoms: Indices  # Ids of the distractors' geoms, (D,)
    distractor_mocap: Indices  # Index in the mocap arrays of each distractor, (D,)
    target_mocap: Indices  # Index in the mocap arrays of each target, (K,)
    # Grasp point relative to the target's position on the support, world axes [m], (K, 3)
    grasp_position: Floats
    grasp_matrix: Floats  # Rotation from grasp frame to world, (K, 3, 3)
    fingers: Fingers | None = None  # None: the agent moves no fingers

    @property
    def num_joints(self) -> int:
        """Number of joints the agent moves."""
        return len(self.qpos_index)

    @property
    def colour_names(self) -> tuple[tuple[str, ...], ...]:
        """Names of each target's colours."""
        return tuple(tuple(target.colours) for target in self.targets)

    def at(self, joints: Floats) -> MjData:
        """Compute the poses of everything with the arm at joint angles (J,) [rad]."""
        data = MjData(self.model)
        data.qpos[self.qpos_index] = joints
        mj_kinematics(self.model, data)
        return data


def build_scene(robot: Robot, targets: Sequence[Target], distractors: int = 0) -> Scene:
    """Compose and compile the scene of an arm whose targets have no physics."""
    with compiling(robot, targets):
        model = compose(robot, targets, distractors).compile()
    return describe_model(model, robot, targets, distractors)


SceneBuilder = Callable[[Robot, Sequence[Target], int], Scene]
"""Builds the scene of a robot, targets and a number of distractors, as `build_scene`."""


def load_scene(
    robot: str,
    targets: tuple[str, ...],
    distractors: int = 0,
    area: str = "reach",
    build: SceneBuilder = build_scene,
) -> Scene:
    """Build the scene of a named robot and named targets, cached per process.

    Both may be TOML files, which are read again when they or the MJCF files beside them change.
    ``area`` is the robot's area in which the targets stand.
    """
    written = []
    for name in (robot, *targets):
        if name.endswith(SUFFIX):
            description = Path(name).resolve()
            for file in (description, *description.parent.glob("*.xml")):
                if file.is_file():
                    written += [file, file.stat().st_mtime_ns]
    return _load_scene(robot, tuple(targets), distractors, area, build, *written)


@lru_cache(maxsize=16)
def _load_scene(
    robot: str,
    targets: tuple[str, ...],
    distractors: int,
    area: str,
    build: SceneBuilder,
    *written: Path | int,
) -> Scene:
    return build(find_robot(robot).for_area(area), find_targets(targets), distractors)


@contextmanager
def compiling(robot: Robot, targets: Sequence[Target]) -> Iterator[None]:
    """Check the targets' names, and name robot and targets where MuJoCo's compiler fails."""
    names = [target.name for target in targets]
    for name in names:
        if names.count(name) > 1 or f"{name}/" == ROBOT_PREFIX:
            raise UserError(
                f"Target {name!r}: of the objects {', '.join(names)} each needs a name of its own, "
                f"other than {ROBOT_PREFIX.removesuffix('/')!r}. Rename the file, or leave it out."
            )
    try:
        yield
    except UserError:
        raise
    except (ValueError, FatalError) as error:
        raise UserError(
            f"The scene of robot {robot.name!r} with {', '.join(names)} does not compile: "
            f"{one_line(error)}. Correct the descriptions."
        ) from error


def describe_model(
    model: MjModel,
    robot: Robot,
    targets: Sequence[Target],
    distractors: int,
) -> Scene:
    """Look up the joints, sites and geoms of a compiled scene, and turn its grasp frames."""
    _turn_grasps(model, robot, targets)
    joint_ids = [model.joint(ROBOT_PREFIX + name).id for name in robot.joints]
    endless = model.jnt_limited[joint_ids] == 0
    ranges = np.where(endless[:, None], ENDLESS_RANGE_RAD, model.jnt_range[joint_ids])
    lower, upper = ranges.T.copy()
    home = np.array(robot.home, dtype=np.float64)
    outside = (home < lower) | (home > upper)
    if outside.any():
        j = int(np.argmax(outside))
        raise UserError(
            f"Robot {robot.name!r}: home of joint {robot.joints[j]!r} is {home[j]:g}; its range is "
            f"{lower[j]:g} to {upper[j]:g}."
        )
    geom_target, geom_coloured, colours = _target_geoms(model, targets)
    _check_sizes(model, targets, geom_target)
    surfaces = ["floor"]
    if robot.table:
        surfaces.append("table")
    shapes = [model.geom(f"{DISTRACTOR}{i}").id for i in range(distractors)]
    distractor_geoms = np.array(shapes, dtype=np.intp)
    distractor_mocap = model.body_mocapid[model.geom_bodyid[distractor_geoms]]
    data = MjData(model)
    mj_kinematics(model, data)
    mj_camlight(model, data)
    camera = model.camera(CAMERA).id
    grasp_sites = [_grasp_site(model, target) for target in targets]
    bodies = model.site_bodyid[grasp_sites]
    # A robot's file can add mocap bodies too.
    target_mocap = model.body_mocapid[model.body_rootid[bodies]]
    scene = Scene(
        model=model,
        robot=robot,
        targets=tuple(targets),
        joint_names=robot.joints,
        qpos_index=model.jnt_qposadr[joint_ids].astype(np.intp),
        joint_lower=lower,
        joint_upper=upper,
        home=home,
        tcp_site=model.site(ROBOT_PREFIX + robot.tcp_site).id,
        camera=camera,
        camera_position=data.cam_xpos[camera].copy(),
        camera_matrix=data.cam_xmat[camera].reshape(3, 3).copy(),
        geom_target=geom_target,
        geom_coloured=geom_coloured,
        target_colours=colours,
        surface_geoms=tuple(model.geom(name).id for name in surfaces),
        distractor_geoms=distractor_geoms,
        distractor_mocap=distractor_mocap.astype(np.intp),
        target_mocap=target_mocap.astype(np.intp),
        grasp_position=data.site_xpos[grasp_sites] - data.xpos[bodies],
        grasp_matrix=data.site_xmat[grasp_sites].reshape(-1, 3, 3),
    )
    _check_in_image(scene)
    return scene


def _target_geoms(
    model: MjModel, targets: Sequence[Target]
) -> tuple[Indices, Mask, Floats32]:
    """Return ``geom_target``, ``geom_coloured`` and ``target_colours`` of a `Scene`."""
    geom_target = np.full(model.ngeom, -1, dtype=np.intp)
    geom_coloured = np.zeros(model.ngeom, dtype=np.bool_)
    width = max(len(target.colours) for target in targets)
    colours = np.zeros((len(targets), width, 3), dtype=np.float32)
    for k, target in enumerate(targets):
        rgb = list(target.colours.values())
        colours[k] = rgb[0]
        colours[k, : len(rgb)] = rgb
        prefix = f"{target.name}/"
        for g in range(model.ngeom):
            name = model.geom(g).name
            if name.startswith(prefix):
                geom_target[g] = k
                geom_coloured[g] = name.removeprefix(prefix) in target.coloured_geoms
    return geom_target, geom_coloured, colours


SMALLEST_M = 0.005
LARGEST_M = 3.0
"""Diameters between which the largest shape of an object lies."""


def _check_sizes(
    model: MjModel,
    targets: Sequence[Target],
    geom_target: Indices,
) -> None:
    """Refuse objects that no arm grasps, as of a mesh in millimetres."""
    for k, target in enumerate(targets):
        diameter = 2 * model.geom_rbound[geom_target == k].max(initial=0.0)
        if not SMALLEST_M < diameter < LARGEST_M:
            raise UserError(
                f"Target {target.name!r}: the largest shape of {target.mjcf.name} has a diameter "
                f"of {diameter:.3g} m, and lengths are in metres. A mesh in millimetres needs "
                'scale="0.001 0.001 0.001".'
            )


def target_places(scene: Scene, position: Floats) -> Floats:
    """Lift positions (..., 2) [m] to the support: (..., 3) [m], world."""
    height = np.full_like(position[..., :1], scene.robot.support_height_m)
    return np.concat([position, height], axis=-1)


def project(
    scene: Scene,
    points: Floats,
    view: NDArray[np.floating] | None = None,
) -> Floats:
    """Project world points (n, 3) [m] into the square image, (n, 2).

    Right and up from the centre in half image widths; NaN for points behind the camera. ``view``,
    (12,), is the camera's position [m] and rotation to world where it is not the scene's.
    """
    if view is None:
        view = np.append(scene.camera_position, scene.camera_matrix)
    local = (points - view[:3]) @ view[3:].reshape(3, 3)
    backward = local[:, 2:]
    depth = np.where(backward < 0, -backward, np.nan)
    half_height = np.tan(np.radians(scene.model.cam_fovy[scene.camera]) / 2)
    return local[:, :2] / (depth * half_height)


def _grasp_site(model: MjModel, target: Target) -> int:
    """Return the id of the site of a target's grasp frame."""
    return int(model.site(f"{target.name}/{target.grasp_site}").id)


def _turn_grasps(
    model: MjModel,
    robot: Robot,
    targets: Sequence[Target],
) -> None:
    """Turn grasp frames about their z axis by the robot's ``grasp_turns_deg``."""
    for target in targets:
        name = "round" if target.round_grasp else target.name
        degrees = robot.grasp_turns_deg.get(name, 0.0)
        if degrees:
            site = _grasp_site(model, target)
            turn = np.round(turn_about_z(degrees), 8)  # exact for half a turn
            turned = np.zeros(4)
            mju_mulQuat(turned, model.site_quat[site], turn)
            mju_normalize4(turned)
            model.site_quat[site] = turned
            model.site_sameframe[site] = mjtSameFrame.mjSAMEFRAME_NONE


def _check_in_image(scene: Scene) -> None:
    """Check that all grasp points are inside the image at the corners of the rectangle."""
    robot = scene.robot
    signs = np.array(list(product((-1, 1), repeat=2)))
    offsets = signs * np.array(robot.rectangle_half_size_m)
    corners = target_places(scene, np.array(robot.rectangle_centre_m) + offsets)
    for target, grasp_position in zip(scene.targets, scene.grasp_position, strict=True):
        image_point = project(scene, corners + grasp_position)
        inside = (np.abs(image_point) <= 1).all(axis=1)
        if not inside.all():
            x, y, _ = corners[int(np.argmin(inside))]
            raise UserError(
                f"Robot {robot.name!r}: target {target.name!r} standing at x {x:.3f}, y {y:.3f} m "
                "has its grasp point outside the image. The image (camera_position_m, "
                "camera_look_at_m, camera_fovy_deg) must show the whole rectangle "
                "(rectangle_centre_m, rectangle_half_size_m): widen the view or shrink the "
                "rectangle."
            )
