"""The pose of a camera is found from clicked points, and told from the robot's."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from knowarm.cli.main import main
from knowarm.own_robot.camera_check import check_camera, fit_camera, named_points
from knowarm.world.config import EnvConfig, scene_of

CONFIG = EnvConfig(robot="irb120")


@pytest.fixture(scope="module")
def scene():
    return scene_of(CONFIG)


def points(scene):
    data = mujoco.MjData(scene.model)
    data.qpos[scene.qpos_index] = scene.home
    mujoco.mj_kinematics(scene.model, data)
    return named_points(scene, data)


def seen_by(scene, places, position, rotation, fovy_deg):
    """Project by hand: right and up from the centre in half image heights."""
    local = (places - position) @ rotation.as_matrix()
    return local[:, :2] / -local[:, 2:] / np.tan(np.radians(fovy_deg) / 2)


def moved(scene, shift, turn_deg, change_deg=0.0):
    """Return a camera beside the robot's."""
    rotation = Rotation.from_matrix(scene.camera_matrix) * Rotation.from_rotvec(
        np.radians(turn_deg)
    )
    return (
        scene.camera_position + shift,
        rotation,
        scene.robot.camera_fovy_deg + change_deg,
    )


@pytest.mark.parametrize(
    ("shift", "turn_deg", "change_deg"),
    [
        ((0, 0, 0), (0, 0, 0), 0),
        ((0.1, -0.05, 0.08), (4, -6, 3), 0),
        ((0, 0.2, 0), (0, 9, 0), 5),
    ],
)
def test_the_camera_is_recovered(scene, shift, turn_deg, change_deg):
    places = np.array([*points(scene).values()])
    position, rotation, fovy_deg = moved(scene, shift, turn_deg, change_deg)
    found = fit_camera(
        scene, seen_by(scene, places, position, rotation, fovy_deg), places
    )
    np.testing.assert_allclose(found[0], position, atol=2e-3)
    assert (found[1].inv() * rotation).magnitude() < 2e-3
    assert found[2] == pytest.approx(fovy_deg, abs=0.1)
    assert found[3] < 1e-3


def write(folder: Path, scene, camera, width=640, height=480):
    """Write a grey photograph and its points."""
    known = points(scene)
    seen = seen_by(scene, np.array([*known.values()]), *camera) * [1, -1] * height / 2
    pixels = seen + np.array([width / 2, height / 2])
    rows = [
        f"{name},{x:.2f},{y:.2f}" for name, (x, y) in zip(known, pixels, strict=True)
    ]
    x, y, z = known["gripper"]
    rows[0] = f"{x} {y} {z}{rows[0].removeprefix('gripper')}"
    (folder / "points.csv").write_text("\n".join(["point,x,y", *rows]))
    Image.new("RGB", (width, height), (200, 0, 0)).save(folder / "photo.png")
    return folder / "photo.png", folder / "points.csv"


def test_a_camera_off_by_a_little_passes_and_by_more_is_corrected(scene, tmp_path):
    camera = moved(scene, (0.004, 0, 0), (0.3, 0, 0))
    files = write(tmp_path, scene, camera)
    checks = check_camera(CONFIG, *files, tmp_path / "overlay.png")
    assert [check.ok for check in checks] == [True] * len(checks)
    camera = moved(scene, (0.05, 0, 0), (0, 3, 0))
    checks = check_camera(
        CONFIG, *write(tmp_path, scene, camera), tmp_path / "overlay.png"
    )
    failed = {check.name: check for check in checks if not check.ok}
    assert set(failed) == {"position", "rotation"}
    assert failed["position"].found == "50.0 mm off"
    assert failed["rotation"].found.startswith("3.0 degrees off, ")
    assert (
        f"camera_position_m = {camera[0].round(3).tolist()}"
        in failed["position"].remedy
    )


def test_points_that_no_camera_sees_suggest_no_pose(scene, tmp_path, capsys):
    photo, points = write(tmp_path, scene, moved(scene, (0.05, 0, 0), (0, 3, 0)))
    lines = points.read_text().splitlines()
    lines[2] = f"{lines[2].split(',')[0]},600,20"
    command = ["doctor", "--camera", str(photo), "--points", str(points)]
    command += ["--image", str(tmp_path / "overlay.png")]
    assert main(command) == 2
    assert capsys.readouterr().err.count("camera_position_m") == 1, (
        "for both checks together"
    )
    points.write_text("\n".join(lines))
    assert main(command) == 2
    shown = capsys.readouterr().err
    assert "1 of 2 checks failed. fit: A point" in shown
    assert "camera_position_m" not in shown


def test_the_overlay_shows_both(scene, tmp_path):
    photo, _ = write(tmp_path, scene, moved(scene, (0, 0, 0), (0, 0, 0)))
    check_camera(CONFIG, photo, None, tmp_path / "overlay.png")
    overlay = np.asarray(Image.open(tmp_path / "overlay.png")).astype(int)
    assert overlay.shape == (480, 480, 3)
    assert overlay[..., 0].min() >= 100, "half of the photograph's red"
    assert overlay[..., 1].std() > 5, "half of the view"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("point,x,y\ngripper,1,2\n", "1 points; give at least 4"),
        ("point,x,y\nnose,1,2\n", "unknown point 'nose'; known: gripper, joint_1"),
        ("point,x,y\n" + "gripper,nan,2\n" * 4, "finite"),
        ("a,b\n1,2\n", "point"),
        ("point,x,y\ngripper,left,2\n", "left"),
    ],
)
def test_wrong_points_are_refused_in_one_line(scene, tmp_path, capsys, text, words):
    photo, _ = write(tmp_path, scene, moved(scene, (0, 0, 0), (0, 0, 0)))
    (tmp_path / "points.csv").write_text(text)
    command = [
        "doctor",
        "--camera",
        str(photo),
        "--points",
        str(tmp_path / "points.csv"),
    ]
    assert main([*command, "--image", str(tmp_path / "overlay.png")]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_a_file_that_is_no_image_is_refused(tmp_path, capsys):
    (tmp_path / "photo.png").write_text("text")
    assert main(["doctor", "--camera", str(tmp_path / "photo.png")]) == 2
    assert "photograph" in capsys.readouterr().err
    assert main(["doctor", "--points", "points.csv"]) == 2
    assert "--camera" in capsys.readouterr().err
