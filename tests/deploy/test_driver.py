"""Safety rules of a driven robot: each test would move the robot without its rule."""

import json
import re
import shutil
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from knowarm.cli.main import main
from knowarm.deploy import watch
from knowarm.deploy.driver import Driver, Safety, decoded, decompressed
from knowarm.deploy.runner import Runner
from knowarm.deploy.watch import Publisher, unheard
from knowarm.errors import UserError
from knowarm.pictures import encode
from tests.source_tree import ROOT

IMAGE = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
NAMES = ["shoulder", "elbow"]
CONTRACT = {
    "control_period_s": 0.1,
    "max_episode_steps": 50,
    "joints": {
        "names": NAMES,
        "lower": [-1.0, -1.0],
        "upper": [1.0, 1.0],
        "home": [0.0, 0.5],
        "mpi": 0.05,
        "increments": [0.0, 0.05, -0.05],
    },
    "workspace_m": {"lower": [-9.0, -9.0, -9.0], "upper": [9.0, 9.0, 9.0]},
    "camera": {"size": 4},
    "knowledge": {"rows": ["usedFor drinking", "usedFor eating"]},
    "recurrent": {"size": 1},
    "recognition": None,
}


class Robot:
    """A runner whose policy always raises both joints, or does ``step``, behind a driver."""

    def __init__(
        self, step=None, *, box=None, gripper=None, lens=None, resize=False, **safety
    ):
        contract = CONTRACT if box is None else CONTRACT | {"workspace_m": box}
        contract = contract | {"camera": CONTRACT["camera"] | (lens or {})}
        self.calls = []

        def policy(inputs):
            self.calls.append(inputs)
            return np.array([[1, 1]]), None, None, inputs["h"], inputs["c"]

        runner = Runner(contract, np.zeros((2, 3), np.float32), policy)
        if step is not None:
            runner.act = lambda observations: setattr(
                runner, "targets", np.array([step])
            )
        gripper = gripper or (lambda angles: np.array([*angles, 0.0]))
        safety = {"confirm_steps": 0} | safety
        self.driver = Driver(
            runner, gripper, Safety(**safety), "usedFor drinking", resize=resize
        )
        self.now = 100.0
        self.driver.clock = lambda: self.now

    def tick(
        self,
        image=IMAGE,
        joints=(0.0, 0.5),
        names=NAMES,
        late=0.0,
        state_late=0.0,
        source="",
    ):
        """Let a period pass; images and states arrive unless they are None."""
        self.now += 0.1
        if image is not None:
            self.driver.see(image, self.now - late)
        if joints is not None:
            self.driver.feel(names, joints, self.now - state_late, source)
        return self.driver.tick(self.now)


def test_a_robot_that_nothing_stops_moves():
    robot = Robot()
    np.testing.assert_allclose(robot.tick(), [0.05, 0.55])
    np.testing.assert_allclose(robot.tick(), [0.1, 0.6])
    assert (robot.driver.steps, robot.driver.end) == (2, "")


@pytest.mark.parametrize(
    ("robot", "words"),
    [
        (Robot([1.01, 0.5]), "shoulder: the target is beyond its limit"),
        (Robot([0.0, np.nan]), "elbow: the target is not finite"),
        (Robot([0.06, 0.5]), "shoulder: faster than 0.5 / s"),
    ],
)
def test_a_target_that_breaks_a_rule_ends_the_episode(robot, words):
    assert robot.tick() is None
    assert robot.driver.end.startswith("stopped")
    assert words in robot.driver.end
    robot.driver._runner.act = lambda observations: None
    assert robot.tick() is None, "an end is final"


@pytest.mark.parametrize("place", [[0, 0, -10.0], [0, 10.0, 0], [np.nan, 0, 0]])
def test_the_gripper_stays_in_the_workspace(place):
    robot = Robot(gripper=lambda angles: np.array(place), wait_s=0.5)
    for _ in range(5):
        assert robot.tick() is None
    assert robot.driver.status.startswith("hold: the gripper would leave the workspace")
    assert [robot.tick() for _ in range(3)] == [None] * 3
    assert robot.driver.end.startswith("stopped after 0.5 s")


def test_a_step_out_of_the_workspace_is_shortened():
    box = {"lower": [-9, -9, -9], "upper": [0.03, 9, 9]}
    robot = Robot(box=box)
    np.testing.assert_allclose(robot.tick(), [0.025, 0.525])
    assert robot.tick() is None, "no share of the step fits"
    assert robot.driver.steps == 1


def test_a_blocked_arm_is_not_pushed_further():
    robot = Robot(following_steps=2.1, patience_s=0.5)
    assert robot.tick() is not None
    assert robot.tick() is not None
    assert robot.tick() is None
    assert robot.driver.status == "hold: shoulder, elbow: blocked, or moved by hand"
    np.testing.assert_allclose(robot.tick(joints=(0.1, 0.6)), [0.15, 0.65])
    assert [robot.tick() for _ in range(8)] == [None] * 8
    assert "blocked" in robot.driver.end


def test_a_start_beyond_the_limits_is_refused():
    robot = Robot()
    assert robot.tick(joints=(0.0, 1.2)) is None
    assert "within the limits" in robot.driver.end


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"image": None}, "image not yet seen"),
        ({"joints": None}, "joint angles not yet seen"),
        ({"late": 0.5}, "image more than 0.3 s old"),
        ({"state_late": 0.5}, "joint angles more than 0.3 s old"),
        ({"late": -0.5}, "in the future"),
        ({"late": np.nan}, "image more than"),
        ({"late": 100.1}, "image without a time stamp"),
        ({"state_late": 100.1}, "joint angles without a time stamp"),
        ({"image": IMAGE[:3]}, "(3, 4, 3) instead of (4, 4, 3)"),
        ({"image": np.full_like(IMAGE, 7)}, "image shows a single colour"),
        ({"image": IMAGE.astype(float)}, "instead of"),
        ({"joints": (0.0, np.nan)}, "lack a number for elbow"),
        ({"joints": (0.0, np.inf)}, "lack a number for elbow"),
        ({"joints": (0.0,)}, "lack a number for elbow"),
        ({"names": ["shoulder", "finger"]}, "lack a number for elbow"),
        ({"names": ["a", "b"]}, "joint angles not yet seen"),
    ],
)
def test_old_or_wrong_input_holds_until_it_is_right_again(given, words):
    robot = Robot()
    assert robot.tick(**given) is None
    assert words in robot.driver.status
    assert "\n" not in robot.driver.status
    assert not robot.calls
    np.testing.assert_allclose(robot.tick(), [0.05, 0.55])


def test_images_of_a_camera_with_a_lens_come_whole_and_the_policy_sees_them_rectified():
    robot = Robot(
        lens={"intrinsics": [0.9, 0.9, 0.66, 0.5], "distortion": [-0.2], "fovy_deg": 40}
    )
    whole = np.random.default_rng(0).integers(0, 255, (12, 16, 3), np.uint8)
    for image in (IMAGE, whole[:, 2:14], whole[..., :2], whole.astype(float)):
        assert robot.tick(image) is None
        assert (
            "image is refused: images must be uint8 RGB and whole"
            in robot.driver.status
        )
    assert robot.tick(whole) is not None
    (inputs,) = robot.calls
    assert inputs["image"].shape == (1, 4, 4, 3)


def test_a_camera_that_stops_holds_and_then_ends_the_episode():
    robot = Robot(max_age_s=0.25, patience_s=1)
    robot.tick()
    sent = [robot.tick(image=None) is not None for _ in range(4)]
    assert sent == [True, True, False, False]
    for _ in range(12):
        assert robot.tick(image=None) is None
    assert "image" in robot.driver.end
    assert robot.tick() is None


def test_a_camera_may_start_after_the_driver():
    robot = Robot(patience_s=1, wait_s=3)
    assert [robot.tick(image=None) for _ in range(25)] == [None] * 25
    assert robot.driver.end == ""
    assert robot.tick() is not None
    for _ in range(15):
        robot.tick(image=None)
    assert robot.driver.end.startswith("stopped after 1 s")


def test_joints_are_matched_by_name():
    robot = Robot()
    targets = robot.tick(names=["finger", "elbow", "shoulder"], joints=(9.0, 0.2, 0.1))
    np.testing.assert_allclose(targets, [0.15, 0.25])


def test_targets_keep_the_control_period():
    robot = Robot()
    robot.tick()
    robot.now -= 0.05
    assert robot.tick() is None
    assert robot.tick() is not None
    assert robot.driver.steps == 2


def test_a_clock_that_is_set_makes_no_target_earlier():
    """The time of the stamps runs backwards; the driver's own clock does not."""
    robot, sent = Robot(following_steps=1000), 0
    for tick in range(20):
        robot.now -= 0.001
        robot.driver.clock = lambda now=1000 + 0.001 * tick: now
        robot.driver.see(IMAGE, robot.now)
        robot.driver.feel(NAMES, (0.0, 0.5), robot.now)
        sent += robot.driver.tick(robot.now) is not None
    assert sent == 1


@pytest.mark.parametrize("pause", [3900.0, 5.1, -1.0])
def test_a_driver_that_was_paused_ends(pause):
    robot = Robot()
    assert robot.tick() is not None
    robot.now += pause
    assert robot.tick() is None
    assert "s passed between two control periods" in robot.driver.end
    assert robot.tick() is None


def test_two_robots_with_the_same_joints_move_nothing():
    robot = Robot(patience_s=1)
    for number in range(15):
        robot.driver.feel(NAMES, (0.2, 0.6), robot.now + 0.05)
        assert robot.tick(joints=(0.0, 0.5)) is None, number
    assert "joint angles jump" in robot.driver.status
    robot = Robot()
    robot.tick()
    assert robot.tick(joints=(0.15, 0.5)) is None
    assert robot.tick(joints=(0.15, 0.5)) is not None, "one jump passes"


@pytest.mark.parametrize("images", [1, 2, 3, 5])
@pytest.mark.parametrize(
    ("steps", "turn", "follows", "most"),
    [
        (1.0, np.inf, True, 5),
        (1.0, 0.01, True, 12),
        (1.0, 0.01, False, 12),
        (0.25, 0.01, True, 12),
        (0.25, 0.01, False, 12),
    ],
)
def test_old_images_with_new_stamps_end_a_motion(images, steps, turn, follows, most):
    """The camera repeats one image, or several in turn; the commands go on, or to and fro."""
    robot, joints, sent = Robot(patience_s=1), np.array([0.0, 0.5]), 0
    runner = robot.driver._runner

    def act(observations):
        sign = 1 if runner.targets[0, 0] < turn else -1
        runner.targets = runner.targets + sign * steps * 0.05

    runner.act = act
    for number in range(60):
        targets = robot.tick(IMAGE + np.uint8(number % images), joints)
        sent += targets is not None
        if follows and targets is not None:
            joints = targets
    assert sent <= most + images
    assert "the image is the same as before the arm moved" in robot.driver.end


def test_a_policy_that_waits_may_see_the_same_image():
    robot = Robot(step=[0.0, 0.5], max_steps=40)
    assert sum(robot.tick() is not None for _ in range(40)) == 40


@pytest.mark.parametrize("apart", [0.001, 0.02, 0.08, 0.3])
@pytest.mark.parametrize("every", [1, 2, 7, 15], ids="every {} periods".format)
def test_joints_of_two_programs_move_nothing(apart, every):
    robot, sent = Robot(patience_s=1, following_steps=1000), []
    for number in range(60):
        if number % every == 0:
            angles = (apart, 0.5)
            robot.driver.feel(NAMES, angles, robot.now + 0.1, "second")
        sent.append(robot.tick(IMAGE + np.uint8(number), source="first") is not None)
    assert not any(sent)
    words = ("joint angles of shoulder come from 2 programs", "joint angles jump")
    assert any(text in robot.driver.status for text in words)


def test_one_joint_of_a_second_program_suffices_and_other_joints_do_not_matter():
    robot = Robot(patience_s=1)
    robot.driver.feel(["finger", "elbow"], (0.0, 0.5), robot.now, "gripper")
    assert robot.tick(source="arm") is None
    assert "joint angles of elbow come from 2 programs" in robot.driver.status
    robot = Robot()
    robot.driver.feel(["finger"], (0.0,), robot.now, "gripper")
    assert robot.tick(source="arm") is not None


def test_a_second_program_that_left_before_the_start_is_forgotten():
    robot = Robot(patience_s=1, wait_s=60)
    robot.driver.feel(NAMES, (0.0, 0.5), robot.now, "before the restart")
    moved = [robot.tick(source="after it") is not None for _ in range(25)]
    assert moved[:15] == [False] * 15
    assert moved[-1]


@pytest.mark.parametrize(
    ("names", "joints", "words"),
    [
        ([*NAMES, "elbow"], (0.0, 0.5, 0.9), "name elbow twice"),
        ([*NAMES, "elbow"], (0.0, 0.5, 0.5), "name elbow twice"),
        (["shoulder", *NAMES], (0.0, 0.0, 0.5), "name shoulder twice"),
        (["elbow", "elbow"], (0.5, 0.5), "name elbow twice"),
        (("shoulder", "elbow", "elbow"), (0.0, 0.5), "name elbow twice"),
        (NAMES, (0.0, 0.5, 0.1), "more numbers than names"),
    ],
)
def test_joint_states_that_contradict_themselves_hold(names, joints, words):
    robot = Robot()
    assert robot.tick(names=names, joints=joints) is None
    assert words in robot.driver.status
    assert robot.tick() is not None
    assert (
        robot.tick(names=["finger", "finger", *NAMES], joints=(9, 8, 0.0, 0.5))
        is not None
    )


BOOL = "std_msgs/msg/Bool"
EMPTY = "std_msgs/msg/Empty"


def test_a_publisher_that_cannot_be_heard_is_named():
    heard = Publisher(EMPTY)
    assert unheard("/stop", EMPTY, []) == unheard("/stop", EMPTY, [heard, heard]) == ""
    for other in (BOOL, "std_msgs/msg/String", "std_srvs/srv/Empty", "", "Empty"):
        problem = unheard("/stop", EMPTY, [heard, Publisher(other)])
        assert f"publishes {other} to /stop" in problem
    problem = unheard("/stop", EMPTY, [Publisher(EMPTY, connects=False)])
    assert "quality of service" in problem


def test_few_images_are_remembered(monkeypatch):
    monkeypatch.setattr(watch, "MOST_IMAGES", 3)
    images = watch.ImageWatch(0.05)
    for number in range(9):
        images.problem(IMAGE + np.uint8(number), np.zeros(2))
    assert len(images._poses) == 3


def test_the_first_steps_are_confirmed_one_by_one():
    robot = Robot(confirm_steps=2)
    robot.driver.confirm()  # nothing is proposed yet
    for number in (1, 2):
        for _ in range(3):
            assert robot.tick() is None
        assert f"step {number} of 50: shoulder +0.050" in robot.driver.status
        robot.driver.confirm()
        assert robot.tick() is not None
        assert len(robot.calls) == number
    assert robot.tick() is not None


def test_a_confirmed_step_waits_for_new_input_and_is_checked_again():
    robot = Robot(confirm_steps=1, following_steps=2)
    robot.tick()
    robot.driver.confirm()
    robot.now += 1
    assert robot.driver.tick(robot.now) is None
    assert robot.tick(IMAGE + np.uint8(1), joints=(0.0, 0.0)) is None
    assert "moved by hand" in robot.driver.status
    assert robot.tick() is None, "the next proposal needs a confirmation of its own"


def test_a_confirmation_is_of_what_is_seen_now():
    robot = Robot(confirm_steps=1, patience_s=5)
    robot.tick()
    first = robot.calls[0]
    for _ in range(60):
        robot.tick(image=IMAGE + np.uint8(1))
    assert len(robot.calls) == 2
    np.testing.assert_array_equal(robot.calls[1]["image"][0], IMAGE + np.uint8(1))
    assert robot.calls[1]["episode_start"] == first["episode_start"], (
        "the memory is as before"
    )
    robot.driver.confirm()
    np.testing.assert_allclose(robot.tick(), [0.05, 0.55])


def test_a_step_is_not_confirmed_during_a_hold():
    robot = Robot(confirm_steps=1)
    robot.tick()
    robot.now += 1
    robot.driver.tick(robot.now)
    assert robot.driver.status.startswith("hold: ")
    robot.driver.confirm()
    assert robot.tick() is None
    assert "Enter moves" in robot.driver.status
    robot.driver.confirm()
    assert robot.tick() is not None


@pytest.mark.parametrize(
    ("levels", "state", "words"),
    [
        ([[99, 1]], 0.0, "beyond 0 to 2"),
        ([[-1, -1]], 0.0, "beyond 0 to 2"),
        ([[1.0, 1.0]], 0.0, "float64"),
        ([[True, False]], 0.0, "bool"),
        ([[1]], 0.0, r"levels \(1, 1\)"),
        ([[1, 1, 1]], 0.0, r"levels \(1, 3\)"),
        ([[1, 1]], np.nan, "no finite state"),
    ],
)
def test_what_no_policy_gives_moves_nothing(levels, state, words):
    robot = Robot()
    robot.driver._runner._policy = lambda inputs: (
        np.array(levels),
        None,
        None,
        inputs["h"] + state,
        inputs["c"],
    )
    assert robot.tick() is None
    assert re.search(words, robot.driver.end)


@pytest.mark.parametrize(
    ("part", "values"),
    [
        ("joints", {"mpi": np.nan}),
        ("joints", {"increments": [0.0, np.nan, 0.0]}),
        ("joints", {"increments": [0.0, 3.0, -3.0]}),
        ("joints", {"lower": [1.0, 1.0], "upper": [-1.0, -1.0]}),
        ("joints", {"lower": [-np.inf, -1.0]}),
        ("joints", {"lower": [-1.0]}),
        ("joints", {"lower": ["a", "b"]}),
        ("joints", {"names": ["elbow", "elbow"]}),
        ("joints", {"names": ["elbow"]}),
        ("workspace_m", {"lower": [np.nan] * 3}),
        ("knowledge", {"rows": []}),
        ("knowledge", {"rows": ["a", "a"]}),
        ("camera", {"size": 0}),
        ("recurrent", {"size": -1}),
        (None, {"control_period_s": 0.0}),
        (None, {"control_period_s": -1.0}),
    ],
)
def test_a_contract_by_which_nothing_should_move_is_refused(part, values):
    contract = CONTRACT | (values if part is None else {part: CONTRACT[part] | values})
    with pytest.raises(ValueError, match=r"the contract is damaged|could not convert"):
        Runner(contract, np.zeros((2, 3), np.float32), print)
    with pytest.raises(ValueError, match="numbers are finite"):
        Runner(CONTRACT, np.full((2, 3), np.nan, np.float32), print)


def test_a_stop_during_the_computation_sends_nothing():
    robot = Robot()
    act = robot.driver._runner.act
    robot.driver._runner.act = lambda seen: robot.driver.stop("stopped") or act(seen)
    assert robot.tick() is None
    assert robot.driver.status == "stopped"


def test_the_step_limit_ends_the_episode():
    robot = Robot(max_steps=2)
    assert [robot.tick() is not None for _ in range(4)] == [True, True, False, False]
    assert robot.driver.completed
    assert robot.driver.end == "all 2 steps are played"


def test_a_stop_is_final_and_keeps_its_first_reason():
    robot = Robot()
    robot.driver.stop("")
    assert robot.tick() is None
    robot = Robot()
    robot.driver.stop("stopped by /knowarm/stop")
    robot.driver.stop("later")
    assert robot.tick() is None
    assert robot.driver.end == "stopped by /knowarm/stop"
    assert not robot.driver.completed


def test_an_obstacle_of_the_caller_holds():
    robot = Robot()
    robot.tick(image=None)
    robot.driver.see(IMAGE, robot.now)
    assert robot.driver.tick(robot.now, "no controller") is None
    assert robot.driver.status == "hold: no controller"
    assert robot.tick() is not None


def test_a_dry_run_computes_from_where_the_arm_is_and_sends_nothing():
    robot = Robot(dry_run=True, confirm_steps=5, max_steps=20)
    for _ in range(20):
        assert robot.tick() is None
    assert len(robot.calls) == 20
    assert "step 19 of 20" not in robot.driver.status
    assert robot.driver.completed


def test_unknown_knowledge_is_refused_before_anything_is_seen():
    runner = Robot().driver._runner
    for given in ("usedFor flying", None):
        with pytest.raises(UserError, match="knowledge must be a row"):
            Driver(runner, lambda angles: angles, Safety(), given)


@pytest.mark.parametrize(
    "values",
    [
        {"max_age_s": 0.0},
        {"patience_s": np.nan},
        {"wait_s": -1.0},
        {"confirm_steps": -1},
        {"max_steps": 0},
    ],
)
def test_rules_without_meaning_are_refused(values):
    with pytest.raises(UserError, match=next(iter(values))):
        Safety(**values)


def test_ros_images_are_decoded_or_refused():
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    padded = np.pad(pixels.reshape(2, 12), ((0, 0), (0, 4)))
    np.testing.assert_array_equal(decoded("rgb8", 2, 4, 16, padded.tobytes()), pixels)
    np.testing.assert_array_equal(
        decoded("bgr8", 2, 4, 12, pixels.tobytes()), pixels[..., ::-1]
    )
    for wrong in (
        ("16UC1", 2, 4, 12, pixels.tobytes()),
        ("rgb8", 2, 4, 11, pixels.tobytes()),
        ("rgb8", 3, 4, 12, pixels.tobytes()),
        ("rgba8", 2, 4, 12, pixels.tobytes()),
        ("rgb8", 0, 0, 0, b""),
    ):
        assert isinstance(decoded(*wrong), str)
    assert "is grey, and the policy sees colours" in decoded(
        "mono8", 2, 4, 4, b"12345678"
    )
    with_alpha = np.pad(pixels, ((0, 0), (0, 0), (0, 1))).tobytes()
    np.testing.assert_array_equal(decoded("rgba8", 2, 4, 16, with_alpha), pixels)
    np.testing.assert_array_equal(
        decoded("bgra8", 2, 4, 16, with_alpha), pixels[..., ::-1]
    )


def test_compressed_images_are_decoded_or_refused():
    np.testing.assert_array_equal(decompressed(encode(IMAGE, "PNG")), IMAGE)
    smooth = np.full((16, 16, 3), [200, 100, 50], np.uint8)
    found = decompressed(encode(smooth, "JPEG")).astype(int)
    assert np.abs(found - smooth).max() <= 4
    for wrong in (
        encode(IMAGE[..., 0], "PNG"),
        encode(IMAGE, "BMP"),
        b"",
        encode(IMAGE, "PNG")[:50],
    ):
        reason = decompressed(wrong)
        assert isinstance(reason, str)
        assert " at 0x" not in reason


def test_larger_images_are_cut_and_averaged():
    image = np.zeros((8, 12, 3), np.uint8)
    image[:, 2:10] = 100
    image[0:2, 2:4] = 200
    robot = Robot(resize=True)
    assert robot.tick(image=image) is not None
    small = robot.calls[0]["image"][0]
    assert small.shape == (4, 4, 3)
    assert small[0, 0, 0] == 200
    assert (small.reshape(-1, 3)[1:] == 100).all()
    assert Robot().tick(image=image) is None
    assert robot.tick(image=IMAGE[:2, :2]) is None, "no image is enlarged"
    assert "(2, 2, 3) instead of" in robot.driver.status


def test_a_run_does_not_set_its_own_speed_limit(tmp_path, capsys, monkeypatch):
    run = shutil.copytree(ROOT / "zoo" / "irb120-full-fast", tmp_path / "run")
    values = json.loads((run / "config.json").read_text())
    monkeypatch.setitem(sys.modules, "knowarm.deploy.ros", SimpleNamespace(drive=print))
    assert main(["ros", str(run)]) == 0
    values["env"]["mpi_rad"] = 1.0
    (run / "config.json").write_text(json.dumps(values))
    for command in ("ros", "serve", "export"):
        assert main([command, str(run)]) == 2
        assert "by up to 1 rad per step" in capsys.readouterr().err
