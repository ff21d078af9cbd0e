"""Contract: what a robot, camera and caller must provide to play a trained policy; its export."""

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from knowarm.arrays import Floats
from knowarm.config import to_dict
from knowarm.deploy import runner
from knowarm.deploy.joint_map import real_joints
from knowarm.deploy.onnx_export import (
    INPUTS,
    OUTPUTS,
    RECOGNITION_INPUTS,
    RECOGNITION_OUTPUTS,
    PolicyStep,
    export_onnx,
    torch_model,
)
from knowarm.deploy.runner import FORMAT, Runner, Start, fingerprint
from knowarm.errors import UserError
from knowarm.experiment.load import TrainedAgent
from knowarm.perception import grounding
from knowarm.perception.recognition import FrameRecognition
from knowarm.reading import digest, read_bytes, replacing, write_json, writing
from knowarm.world.config import row_names, scene_of
from knowarm.world.envs.running import joint_increments
from knowarm.world.robots.robot import FINGERS_JOINT
from knowarm.world.scene.compose import CONTROL_PERIOD_S
from knowarm.world.scene.scene import Scene, target_places

Description = dict[str, Any]
"""The contract, or a part of it."""

WORKSPACE_MARGIN_M = 0.15
"""How far the workspace reaches beyond start poses and grasp points [m]."""


class RecognitionStep(nn.Module):
    """`FrameRecognition.locate`: first images and what is known of their queries, to knowledge."""

    def __init__(self, recognition: FrameRecognition) -> None:
        super().__init__()
        self.recognition = recognition

    def forward(self, image: Tensor, query: Tensor) -> Tensor:
        """Compute the knowledge of the policy, (B, K), of images and queries (B, D)."""
        return self.recognition.locate(image, query)


@dataclass(frozen=True)
class Deployment:
    """A trained agent, taken apart into what a runner needs."""

    policy: PolicyStep
    recognition: nn.Module | None
    """Network that computes the knowledge from the first image and a query, or None."""
    knowledge: NDArray[np.float32]
    """Knowledge table, or table of queries for the grounding network, (rows, width)."""
    contract: Description
    scene: Scene

    def runner(self) -> Runner:
        """Return a runner that computes with PyTorch."""
        models = [torch_model(self.policy, INPUTS)]
        if self.recognition is not None:
            models.append(torch_model(self.recognition, RECOGNITION_INPUTS))
        return Runner(self.contract, self.knowledge, *models)


def deployment(trained: TrainedAgent, joint_map: Path | None = None) -> Deployment:
    """Take a trained agent apart.

    ``joint_map`` is a TOML file whose table of that name replaces that of the robot.

    Raises:
        UserError: its MPI is larger than that of the robot, or the joint map does not fit.
    """
    env = trained.config.env
    if trained.config.solves:
        raise UserError(
            "A run of the algorithm 'seen' has no policy to take out of the simulator: inverse "
            "kinematics act in its place. Train one, e.g. with the algorithm 'distil'."
        )
    if env.task.skill.tells_facts:
        raise UserError(
            "This policy is told the tray on which an object belongs, by facts of the episode and "
            "the colours of the first image, and an export has neither. Play it by `knowarm.play`, "
            "`evaluate`, `ask`, `view` or `record`."
        )
    rows = row_names(env)
    table = trained.table
    step = None
    recognized: Description | None = None
    recognition = trained.agent.recognition
    if recognition is not None:
        table = recognition.knowledge.numpy()
        step = RecognitionStep(recognition)
        recognized = {
            "file": "recognition.onnx",
            "format": grounding.FORMAT,
            "digest": digest(recognition.network.to_bytes()),
            "when": "in the first image of an episode",
        }
    scene = scene_of(env)
    if not table.size:
        table = np.zeros((1, 0))
        rows = ["any"]
    elif (table == table[:1]).all():  # the same knowledge in every episode
        table = table[:1]
        rows = ["any"]
    increments = joint_increments(scene.robot, env)
    mpi = increments.max()
    if mpi > scene.robot.mpi_rad:
        raise UserError(
            f"{trained.folder.path} moves a joint by up to {mpi:g} rad per step, and the "
            f"description of {scene.robot.name} allows mpi_rad = {scene.robot.mpi_rad:g}. A run "
            "does not set its own limit: train with that of the robot."
        )
    table = np.ascontiguousarray(table, dtype=np.float32)
    lower, upper = workspace(scene)
    success = []
    for summary in trained.folder.summaries():
        about = {"label": summary.label, "episodes": int(summary["episodes"])}
        success.append(about | summary.interval("success").named("success"))
    contract = {
        "format": FORMAT,
        "origin": {
            "experiment": trained.config.name,
            "seed": trained.config.seed,
            "checkpoint": trained.which,
            "step": trained.step,
        },
        "control_period_s": CONTROL_PERIOD_S,
        "max_episode_steps": env.max_episode_steps,
        "joints": _joints(scene, increments, joint_map),
        "workspace_m": {"lower": lower.tolist(), "upper": upper.tolist()},
        "camera": _camera(scene, env.image_size),
        "knowledge": {
            "file": "knowledge.npy",
            "rows": rows,
            "meaning": env.task.asked.knowledge_info,
            "origin": to_dict(trained.config.knows),
        },
        "recognition": recognized,
        "recurrent": {
            "size": trained.policy.hidden_size,
            "inputs": INPUTS[2:4],
            "outputs": OUTPUTS[3:],
            "reset": "zeros and episode_start true at the first step of every episode",
        },
        "success": success,
        "digests": {},
    }
    return Deployment(
        policy=PolicyStep(trained.policy),
        recognition=step,
        knowledge=table,
        contract=contract,
        scene=scene,
    )


def export(
    trained: TrainedAgent, folder: Path, joint_map: Path | None = None
) -> Deployment:
    """Write models, knowledge table, contract and runner; return what was exported.

    Raises:
        UserError: the folder cannot be written to, or packages are missing.
    """
    parts = deployment(trained, joint_map)
    with writing(folder, "Give another folder."):
        folder.mkdir(parents=True, exist_ok=True)
        files = ["policy.onnx", "knowledge.npy"]
        about = {"contract": fingerprint(parts.contract)}
        example = parts.policy.example()
        export_onnx(parts.policy, example, folder / "policy.onnx", about=about)
        if parts.recognition is not None:
            files.append("recognition.onnx")
            image, *_ = example
            export_onnx(
                parts.recognition,
                (image, torch.from_numpy(parts.knowledge[[0, 0]])),
                folder / "recognition.onnx",
                about=about,
                inputs=RECOGNITION_INPUTS,
                outputs=RECOGNITION_OUTPUTS,
            )
        with replacing(folder / "knowledge.npy") as temporary:
            np.save(temporary, parts.knowledge)
        with replacing(folder / "runner.py") as temporary:
            temporary.write_bytes(read_bytes(Path(runner.__file__)))
        digests = {name: digest(read_bytes(folder / name)) for name in files}
        parts = replace(parts, contract=parts.contract | {"digests": digests})
        write_json(folder / "contract.json", parts.contract)
    return parts


def play_once(player: Runner) -> None:
    """Let a runner import and compile what it needs: later no file may be free to open."""
    joints = player.contract["joints"]
    home = dict(zip(joints["names"], joints["home"], strict=True))
    player.reset(Start(home, player.contract["knowledge"]["rows"][0]))
    player.act({"image": np.zeros((1, *player.image_shape), np.uint8)})


def tcp_position(scene: Scene, joints: Floats) -> Floats:
    """Compute the gripper's position (3,) [m], world, at joint angles (J,) [rad]."""
    return scene.at(joints).site_xpos[scene.tcp_site].copy()


def start_spread(scene: Scene) -> Floats:
    """Return how far start poses are from home, at most, (J,) [rad]; 0 for joints at home."""
    moved = np.isin(np.arange(scene.num_joints), scene.robot.start_joints)
    half_range = (scene.joint_upper - scene.joint_lower) / 2
    return np.where(moved, scene.robot.start_fraction * half_range, 0.0)


def workspace(scene: Scene) -> Floats:
    """Return lower and upper corner, (2, 3) [m], of a box around start poses and grasp points.

    It ends at the height of the support.
    """
    robot = scene.robot
    centre = np.array(robot.rectangle_centre_m)
    half = np.array(robot.rectangle_half_size_m)
    signs = np.array([*product((-1, 1), repeat=2)])
    corners = target_places(scene, centre + signs * half)
    points = [*np.concatenate(corners[:, None] + scene.grasp_position)]
    moved = list(robot.start_joints)
    spread = start_spread(scene)[moved]
    for factors in product(np.linspace(-1, 1, 5), repeat=len(moved)):
        start = scene.home.copy()
        start[moved] += factors * spread
        start = start.clip(scene.joint_lower, scene.joint_upper)
        points.append(tcp_position(scene, start))
    lower = np.min(points, axis=0) - WORKSPACE_MARGIN_M
    upper = np.max(points, axis=0) + WORKSPACE_MARGIN_M
    lower[2] = robot.support_height_m
    return np.stack([lower, upper])


def _joints(scene: Scene, increments: Floats, joint_map: Path | None) -> Description:
    """Describe the policy's joints, and those of the real arm where they differ."""
    joints: Description = {
        "robot": scene.robot.name,
        "names": scene.joint_names,
        "unit": "rad (slides: m)",
        "lower": scene.joint_lower.tolist(),
        "upper": scene.joint_upper.tolist(),
        "home": scene.home.tolist(),
        "start_offset": start_spread(scene).tolist(),
        "mpi": float(increments.max()),
        "increments": increments.tolist(),
        "command": "position target: previous target + increments[action], clipped to the limits",
    }
    if scene.fingers is not None:
        joints["gripper"] = {
            "joint": FINGERS_JOINT,
            "unit": "m of each finger, from 0 (open); targets beyond closed press harder",
            "closed": scene.fingers.closed_m,
            "mpi": joints["mpi"],
            "force_n": scene.fingers.force_n,
        }
    real = real_joints(scene, joint_map)
    plain = [(name, 1.0, 0.0) for name in scene.joint_names]
    sent = [(joint["name"], joint["scale"], joint["offset"]) for joint in real]
    if sent != plain or any("limits" in joint for joint in real):
        joints["real"] = real
    return joints


def _camera(scene: Scene, size: int) -> Description:
    robot = scene.robot
    lens: Description = {}
    if robot.camera_intrinsics is not None:
        lens["intrinsics"] = robot.camera_intrinsics
        lens["distortion"] = robot.camera_distortion
    return {
        **lens,
        "size": size,
        "colours": "RGB",
        "dtype": "uint8",
        "normalization": "none: the models take values 0 to 255",
        "position_m": robot.camera_position_m,
        "look_at_m": robot.camera_look_at_m,
        "rotation": scene.camera_matrix.tolist(),
        "frame": "robot base; rotation from camera (x right, y up, z backward)",
        "fovy_deg": robot.camera_fovy_deg,
    }
