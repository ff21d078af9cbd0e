"""A camera is fitted to clicked points, and judged by how far the policy's pixels move."""

import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from knowarm.cli.main import main
from knowarm.deploy.driver import shrunk
from knowarm.deploy.runner import Lens
from knowarm.errors import UserError
from knowarm.own_robot import camera_check
from knowarm.own_robot.camera_check import check_camera, named_points, rectify
from knowarm.own_robot.pixels import draw_once
from knowarm.world.config import EnvConfig, scene_of
from knowarm.world.objects import find_targets
from knowarm.world.robots import ROBOTS
from knowarm.world.scene.appearance import resting_colours
from knowarm.world.scene.compose import roll
from knowarm.world.scene.scene import build_scene, project
from tests.thorough import thorough

CONFIG = EnvConfig(robot="irb120")
WIDTH, HEIGHT = 640, 480
ASPECT = WIDTH / HEIGHT
pytest.importorskip("cv2")

from knowarm.own_robot.camera_fit import (  # noqa: E402
    FOVY,
    LENS,
    POSE,
    camera_of,
    fit_camera,
    most_free,
)


@pytest.fixture(scope="module")
def scene():
    return scene_of(CONFIG)


@pytest.fixture
def few_cameras(monkeypatch):
    monkeypatch.setattr(camera_check, "CAMERAS", 20)


@pytest.fixture
def five_cameras(monkeypatch):
    """Five judge clicks off by a pixel as twenty do, in a quarter of the time."""
    monkeypatch.setattr(camera_check, "CAMERAS", 5)


def points(scene) -> dict:
    return named_points(scene, scene.at(scene.home))


def real_camera(scene, **changes):
    """Return the robot's camera with changes: shift [m], turn_deg, roll_deg, zoom, k1, off."""
    robot = scene.robot
    if changes.get("on_the_other_side"):
        x, y, z = robot.camera_position_m
        robot = replace(robot, camera_position_m=(x, -y, z))
    camera = camera_of(robot, changes.get("aspect", ASPECT))
    turn = Rotation.from_rotvec(np.radians(changes.get("turn_deg", (0, 0, 0))))
    axes = roll(camera.axes @ turn.as_matrix(), changes.get("roll_deg", 0.0))
    focus = camera.focus * [*[changes.get("zoom", 1.0)] * 2, 1, 1]
    focus[2] += changes.get("off", 0.0)
    lens = np.array([changes.get("k1", 0.0), 0, 0, 0, 0])
    position = camera.position + changes.get("shift", (0, 0, 0))
    return replace(camera, position=position, axes=axes, focus=focus, lens=lens)


def by_hand(camera, places):
    """Project by the pinhole's and the lens' formula, in image heights from the upper left."""
    local = (places - camera.position) @ camera.axes
    right_down = local[:, :2] / -local[:, 2:] * [1, -1]
    square = np.square(right_down).sum(axis=1, keepdims=True)
    bent = right_down * (1 + camera.lens[0] * square)
    return camera.focus[2:] + camera.focus[:2] * bent


@pytest.mark.parametrize(
    "changes",
    [{}, {"shift": (0.1, -0.2, 0.05), "roll_deg": 20, "k1": -0.2, "off": 0.02}],
)
def test_a_camera_sees_what_the_formula_says(scene, changes) -> None:
    places = np.array([*points(scene).values()])
    camera = real_camera(scene, **changes)
    np.testing.assert_allclose(camera.see(places), by_hand(camera, places), atol=1e-9)


def test_the_robots_camera_sees_what_the_scene_projects(scene) -> None:
    places = np.array([*points(scene).values()])
    seen = camera_of(scene.robot, ASPECT).see(places)
    right_up = (seen - [ASPECT / 2, 0.5]) * 2 * [1, -1]
    np.testing.assert_allclose(right_up, project(scene, places), atol=1e-6)


KINDS = {
    "same": {},
    "beside": {"shift": (0.1, -0.05, 0.08), "turn_deg": (4, -6, 3)},
    "wider": {"shift": (0, 0.2, 0), "zoom": 0.8},
    "rolled": {"roll_deg": 5.0},
    "on its side": {"roll_deg": 90.0},
    "upside down": {"roll_deg": 180.0},
    "barrel": {"k1": -0.15},
    "strong barrel": {"k1": -0.3},
    "pincushion": {"k1": 0.2},
    "all": {"shift": (0.03, 0.02, 0), "roll_deg": -12.0, "zoom": 1.2, "k1": -0.1},
}


@pytest.mark.parametrize("name", KINDS)
def test_a_camera_is_recovered_from_exact_points(scene, name: str) -> None:
    places = np.array([*points(scene).values()])
    camera = real_camera(scene, **KINDS[name])
    free = most_free(len(places), scene.robot)
    assert free == LENS
    found = fit_camera(camera_of(scene.robot, ASPECT), camera.see(places), places, free)
    np.testing.assert_allclose(found.position, camera.position, atol=1e-4)
    np.testing.assert_allclose(found.axes, camera.axes, atol=1e-4)
    np.testing.assert_allclose(found.focus, camera.focus, rtol=1e-4)
    np.testing.assert_allclose(found.lens, camera.lens, atol=1e-4)


@pytest.mark.parametrize(
    ("count", "free"), [(4, POSE), (5, POSE), (6, FOVY), (8, FOVY), (9, LENS)]
)
def test_few_points_fit_few_numbers(scene, count: int, free: int) -> None:
    places = np.array([*points(scene).values()])[-count:]
    assert most_free(count, scene.robot) == free
    measured = replace(scene.robot, camera_intrinsics=(1.0, 1.0, 0.7, 0.5))
    assert most_free(count, measured) == POSE
    camera = real_camera(scene, shift=(0.05, 0.02, 0), roll_deg=3.0)
    found = fit_camera(camera_of(scene.robot, ASPECT), camera.see(places), places, free)
    np.testing.assert_allclose(found.position, camera.position, atol=2e-3)


def verdicts(scene, camera, noise_px: float, tries: int, generator) -> float:
    """Return the share of tries in which a camera is accepted, with clicks off by pixels."""
    places = np.array([*points(scene).values()])
    accepted = 0
    for _ in range(tries):
        one = camera(generator)
        clicks = generator.normal(0, noise_px / HEIGHT, (len(places), 2))
        seen = by_hand(one, places) + clicks
        checks = camera_check._compare(scene, CONFIG, ASPECT, seen, places)
        accepted += all(check.ok for check in checks)
    return accepted / tries


def direction(generator) -> np.ndarray:
    vector = generator.standard_normal(3)
    return vector / np.linalg.norm(vector)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "noise_px", "cameras", "tries", "least", "most"),
    [
        (lambda g: {}, 0.5, 5, thorough(10, 20), 0.95, 1),
        (lambda g: {}, 1, 5, thorough(20, 200), 0.95, 1),
        (lambda g: {}, 2, 20, thorough(10, 200), 0.95, 1),
        (lambda g: {"shift": 0.03 * direction(g)}, 1, 5, thorough(20, 40), 0, 0.05),
        (
            lambda g: {"roll_deg": 3.0 * g.choice([-1, 1])},
            1,
            5,
            thorough(20, 40),
            0,
            0.05,
        ),
    ],
    ids=["right .5", "right 1", "right 2", "3 cm", "3 degrees"],
)
def test_right_cameras_are_accepted_and_wrong_ones_refused_in_nineteen_of_twenty_tries(
    scene, monkeypatch, changes, noise_px, cameras, tries, least, most
) -> None:
    monkeypatch.setattr(camera_check, "CAMERAS", cameras)
    generator = np.random.default_rng(1)
    share = verdicts(
        scene, lambda g: real_camera(scene, **changes(g)), noise_px, tries, generator
    )
    assert least <= share <= most


@pytest.mark.parametrize(
    ("changes", "least", "most"),
    [
        (lambda g: {}, 0.95, 1),
        (lambda g: {"shift": 0.03 * direction(g)}, 0, 0.05),
        (lambda g: {"roll_deg": 3.0 * g.choice([-1, 1])}, 0, 0.05),
    ],
    ids=["right", "3 cm", "3 degrees"],
)
def test_the_camera_of_another_arm_is_judged_alike(
    five_cameras, changes, least, most
) -> None:
    scene = scene_of(EnvConfig(robot="tiago"))
    generator = np.random.default_rng(1)
    share = verdicts(
        scene, lambda g: real_camera(scene, **changes(g)), 1, 20, generator
    )
    assert least <= share <= most


@pytest.mark.parametrize(
    ("changes", "accepted"),
    [
        ({}, 1.0),
        ({"shift": (0.003, 0, 0)}, 1.0),
        ({"shift": (0.0, 0.03, 0)}, 0.0),
        ({"roll_deg": -3.0}, 0.0),
        ({"turn_deg": (0, 2, 0)}, 0.0),
        ({"k1": -0.3}, 0.0),
        ({"zoom": 0.9}, 0.0),
        ({"off": 0.05}, 0.0),
        ({"shift": (0.012, 0, 0)}, 0.0),
        ({"on_the_other_side": True}, 0.0),
    ],
)
def test_cameras_with_clicks_off_by_a_pixel(scene, five_cameras, changes, accepted):
    generator = np.random.default_rng(2)
    camera = real_camera(scene, **changes)
    assert verdicts(scene, lambda g: camera, 1, 5, generator) == accepted


def write(folder: Path, scene, camera, width=WIDTH, height=HEIGHT):
    """Write a red photograph and its points."""
    known = points(scene)
    pixels = by_hand(camera, np.array([*known.values()])) * height
    rows = [
        f"{name},{x:.2f},{y:.2f}" for name, (x, y) in zip(known, pixels, strict=True)
    ]
    x, y, z = known["gripper"]
    rows[0] = f"{x} {y} {z}{rows[0].removeprefix('gripper')}"
    (folder / "points.csv").write_text("\n".join(["point,x,y", *rows]))
    Image.new("RGB", (width, height), (200, 0, 0)).save(folder / "photo.png")
    return folder / "photo.png", folder / "points.csv"


WRONG = {
    "beside": {"shift": (0.05, 0, 0), "turn_deg": (0, 3, 0)},
    "rolled": {"roll_deg": 5.0},
    "wider": {"zoom": 0.85},
    "barrel": {"k1": -0.3},
    "rolled barrel": {"k1": -0.15, "roll_deg": 8.0, "shift": (0, 0.02, 0.03)},
}


@pytest.mark.parametrize("name", WRONG)
def test_the_fields_that_the_remedy_names_make_the_check_pass(
    scene, tmp_path, name: str, few_cameras
) -> None:
    files = write(tmp_path, scene, real_camera(scene, **WRONG[name]))
    checks = check_camera(CONFIG, *files, tmp_path / "overlay.png")
    (failed,) = [check for check in checks if not check.ok]
    assert failed.name == "pixels of the policy"
    fields = failed.remedy.split("robot's description ")[1].rstrip(".")
    values = tomllib.loads(fields.replace(", camera_", "\ncamera_"))
    assert ("camera_distortion" in values) is (name == "barrel")
    shipped = ROBOTS["irb120"].mjcf.with_suffix(".toml").read_text()
    kept = [
        line
        for line in shipped.splitlines()
        if line.partition(" ")[0] not in (*values, "mjcf", "gym_name")
    ]
    lines = [*fields.replace(", camera_", "\ncamera_").splitlines(), *kept]
    text = f'mjcf = "{ROBOTS["irb120"].mjcf}"\n' + "\n".join(lines)
    (tmp_path / "arm.toml").write_text(text)
    config = EnvConfig(robot=str(tmp_path / "arm.toml"))
    again = check_camera(config, *files, tmp_path / "overlay.png")
    assert [check for check in again if not check.ok] == []


def test_intervals_hold_the_true_camera(scene, tmp_path, few_cameras) -> None:
    files = write(tmp_path, scene, real_camera(scene, shift=(0.002, 0, 0)))
    checks = {c.name: c for c in check_camera(CONFIG, *files, tmp_path / "o.png")}
    assert all(check.ok for check in checks.values())
    found = checks["camera"].found
    low, high = found.split("x ")[1].split("[")[1].split("]")[0].split(", ")
    assert float(low) <= scene.camera_position[0] + 0.002 <= float(high)
    assert "roll" in found
    assert "field of view" in found


@pytest.mark.filterwarnings("error")
def test_a_photograph_on_its_side_gives_its_roll(scene, tmp_path, few_cameras) -> None:
    camera = real_camera(scene, aspect=HEIGHT / WIDTH, roll_deg=90.0)
    files = write(tmp_path, scene, camera, HEIGHT, WIDTH)
    checks = check_camera(CONFIG, *files, tmp_path / "overlay.png")
    (failed,) = [check for check in checks if not check.ok]
    assert "camera_roll_deg = 90.0" in failed.remedy
    assert "nan" not in " ".join(check.found for check in checks)


def test_points_that_no_camera_sees_suggest_no_pose(scene, tmp_path, capsys):
    photo, points = write(tmp_path, scene, real_camera(scene, shift=(0.05, 0, 0)))
    lines = points.read_text().splitlines()
    command = ["doctor", "--camera", str(photo), "--points", str(points)]
    command += ["--image", str(tmp_path / "overlay.png")]
    assert main(command) == 2
    assert "camera_position_m = " in capsys.readouterr().err
    lines[9] = f"{lines[9].split(',')[0]},600,20"
    points.write_text("\n".join(lines))
    assert main(command) == 2
    shown = capsys.readouterr().err
    assert "1 of 2 checks failed. fit: " in shown
    assert "a point is wrong, most likely number 9" in shown
    assert "camera_position_m" not in shown


def test_the_overlay_shows_both(scene, tmp_path):
    photo, _ = write(tmp_path, scene, real_camera(scene))
    check_camera(CONFIG, photo, None, tmp_path / "overlay.png")
    overlay = np.asarray(Image.open(tmp_path / "overlay.png")).astype(int)
    assert overlay.shape == (480, 480, 3)
    assert overlay[..., 0].min() >= 100, "half of the photograph's red"
    assert overlay[..., 1].std() > 5, "half of the view"


@pytest.mark.parametrize("k1", [0.0, -0.3, 0.2])
def test_a_photograph_is_rectified_to_what_the_policy_sees(scene, k1: float) -> None:
    camera = real_camera(scene, k1=k1, zoom=0.8, off=0.03)
    robot = replace(
        scene.robot,
        camera_intrinsics=tuple(camera.focus),
        camera_distortion=tuple(camera.lens),
    )
    for place in [*points(scene).values()][-4:]:
        pixel = (by_hand(camera, place[None])[0] * HEIGHT).round().astype(int)
        photo = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        photo[pixel[1] - 2 : pixel[1] + 3, pixel[0] - 2 : pixel[0] + 3] = 255
        image = np.asarray(rectify(Image.fromarray(photo), robot, 480)).sum(axis=2)
        rows, columns = np.nonzero(image > 300)
        right_up = project(scene, place[None])[0]
        wanted = (right_up * [1, -1] + 1) * 240
        np.testing.assert_allclose([columns.mean(), rows.mean()], wanted, atol=1.5)


def test_the_runner_rectifies_images_as_opencv_does(scene) -> None:
    camera = real_camera(scene, k1=-0.3, zoom=0.8)
    camera.lens[1:] = [0.1, 0.01, -0.02, 0.03]
    contract = {
        "size": 64,
        "fovy_deg": scene.robot.camera_fovy_deg,
        "intrinsics": tuple(camera.focus),
        "distortion": tuple(camera.lens),
    }
    place = [*points(scene).values()][-4]
    photo = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    photo[100:300, 200:500] = (200, 120, 40)
    x, y = (by_hand(camera, place[None])[0] * HEIGHT).round().astype(int)
    photo[y - 4 : y + 5, x - 4 : x + 5] = 255
    lens = Lens(contract)
    (seen,) = lens.rectified(photo[None])
    assert seen.shape == (64, 64, 3)
    rows, columns = np.nonzero(seen[:, :, 2] > 120)
    wanted = (project(scene, place[None])[0] * [1, -1] + 1) * 32 - 0.5
    np.testing.assert_allclose([columns.mean(), rows.mean()], wanted, atol=0.7)
    robot = replace(
        scene.robot,
        camera_intrinsics=contract["intrinsics"],
        camera_distortion=contract["distortion"],
    )
    fine = np.asarray(rectify(Image.fromarray(photo), robot, 512), float)
    by_opencv = fine.reshape(64, 8, 64, 8, 3).mean(axis=(1, 3))
    assert np.abs(by_opencv - seen).mean() < 1.5
    plain = shrunk(photo, {"size": 64}).astype(float)
    assert np.abs(plain - seen).mean() > 10, "the central square is another image"
    assert shrunk(photo, contract) is photo, "which the runner takes whole"


@pytest.mark.parametrize(
    "shape", [(64, 64), (64, 85), (480, 480), (85, 64), (640, 480), (64, 0), (480, 900)]
)
def test_no_other_images_than_whole_ones_are_rectified(scene, shape: tuple) -> None:
    camera = real_camera(scene, k1=-0.3)
    about = {"size": 64, "fovy_deg": 40.0, "intrinsics": tuple(camera.focus)}
    lens = Lens(about | {"distortion": ()})
    assert lens.problem(np.zeros((1, *lens.shape), np.uint8)) == ""
    assert lens.problem(np.zeros((2, 480, 640, 3), np.uint8)) == ""
    for image in (
        np.zeros((1, *shape, 3), np.uint8),
        np.zeros((480, 640, 3), np.uint8),
        np.zeros((1, 480, 640, 4), np.uint8),
        np.zeros((1, 480, 640, 3)),
    ):
        with pytest.raises(ValueError, match="images must be uint8 RGB and whole"):
            lens.rectified(image)


def test_the_simulator_renders_a_rolled_camera(scene) -> None:
    def image(degrees: float) -> np.ndarray:
        robot = replace(scene.robot, camera_roll_deg=degrees)
        turned = build_scene(robot, find_targets(["mug"]))
        data = turned.at(turned.home)
        colours = resting_colours(turned, 1)
        return np.asarray(draw_once(turned, CONFIG, data, colours, 64)).astype(int)

    level = image(0)
    # The camera's right side turns down, so what it sees turns the other way.
    for degrees, quarters in ((90, 1), (180, 2), (-90, 3)):
        difference = np.abs(image(degrees) - np.rot90(level, quarters)).max(axis=2)
        assert (difference > 25).mean() < 0.02
    assert (np.abs(image(90) - level).max(axis=2) > 25).mean() > 0.05


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"camera_distortion": (0.1, 0, 0, 0, 0)}, "beside camera_intrinsics"),
        (
            {"camera_intrinsics": (1.0, 1.0, 0.5, 0.5), "camera_distortion": (0.1,)},
            "must be k1, k2",
        ),
        ({"camera_intrinsics": (0.0, 1.0, 0.5, 0.5)}, "begin with focal lengths"),
    ],
)
def test_lenses_that_cannot_be_are_refused(scene, fields: dict, words: str) -> None:
    with pytest.raises(UserError, match=words):
        replace(scene.robot, **fields)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("point,x,y\ngripper,1,2\n", "1 points; give at least 4"),
        ("point,x,y\nnose,1,2\n", "unknown point 'nose'; known: gripper, joint_1"),
        ("point,x,y\n" + "gripper,nan,2\n" * 4, "finite"),
        ("a,b\n1,2\n", "point"),
        ("point,x,y\ngripper,left,2\n", "left"),
        ("point,x,y\n" + "gripper,1,2\n" * 4, "different places"),
    ],
)
def test_wrong_points_are_refused_in_one_line(scene, tmp_path, capsys, text, words):
    photo, _ = write(tmp_path, scene, real_camera(scene))
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


def test_a_photograph_that_fills_the_memory_is_refused(tmp_path):
    photo = tmp_path / "photo.png"
    Image.new("RGB", (6000, 6000)).save(photo)
    # In a process of its own: the limit counts new memory, and this one may have some to reuse.
    command = (
        "import sys; from knowarm import fence; from knowarm.cli.main import main; "
        f"fence.MEMORY = 2**24; sys.exit(main(['doctor', '--camera', {str(photo)!r}]))"
    )
    result = subprocess.run(
        [sys.executable, "-c", command], cwd=tmp_path, capture_output=True, text=True
    )
    assert result.returncode == 2
    assert "needs more than 60 s or 0.0 GiB" in result.stderr
    assert result.stderr.count("\n") == 1
