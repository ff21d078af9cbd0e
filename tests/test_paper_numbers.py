"""Golden test: numbers of the paper and of the robots' data sheets, independent of the code.

Sources: "paper" is Güitta-López et al., Robotics 2025, 14, 86, by section; [A] ros-industrial
abb_irb120_support, irb120_3_58_macro.xacro; [C] pal-robotics tiago_robot, arm xacros. Every number
is written out here: a test that read it from the package would follow its mistakes.
"""

import numpy as np
import pytest
import torch

from knowarm.experiment.config import InterimConfig
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.names import experiment_config
from knowarm.experiment.summary import WIDE_ANGLE_DEG
from knowarm.policy import Policy, PolicyConfig, PolicyShape
from knowarm.statistics import one_way_anova
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.scene import load_scene
from knowarm.world.tasks.reward import is_success, paper_reward

TARGETS = ("mug", "bottle", "cereal_box")  # paper 3.1

JOINT_RANGES = {  # [A], [C], in rad
    "irb120": [
        (-2.87979, 2.87979),
        (-1.91986, 1.91986),
        (-1.91986, 1.22173),
        (-2.79253, 2.79253),
        (-2.094395, 2.094395),
        (-6.98132, 6.98132),
    ],
    "tiago": [
        (0, 2.74889),
        (-1.5708, 1.09083),
        (-3.53429, 1.5708),
        (-0.392699, 2.35619),
        (-2.0944, 2.0944),
        (-1.41372, 1.41372),
        (-2.0944, 2.0944),
    ],
}
LINKS = {  # [A], [C]: offset from the parent [m] and mass [kg]
    "irb120": {
        "link_2": ((0, 0, 0.290), 3.909),
        "link_3": ((0, 0, 0.270), 2.944),
        "link_4": ((0, 0, 0.070), 1.328),
        "link_5": ((0.302, 0, 0), 0.546),
        "link_6": ((0.072, 0, 0), 0.137),
    },
    "tiago": {
        "arm_1": ((0.15505, 0.014, -0.151), 1.563),
        "arm_2": ((0.125, 0.0195, -0.031), 1.800),
        "arm_3": ((0.0895, 0, -0.0015), 1.800),
        "arm_4": ((-0.02, -0.027, -0.222), 1.433),
        "arm_5": ((-0.162, 0.02, 0.027), 0.936),
        "arm_6": ((0, 0, 0.15), 0.303),
        "arm_7": ((0, 0, 0), 1.003),  # with gripper
    },
}
AXES = {"irb120": ["z", "y", "y", "x", "y", "x"], "tiago": ["z"] * 7}
RECTANGLES = {  # paper 3.3: 60 x 20 cm and 20 x 25 cm; centres from the robots' facts [m]
    "irb120": ((0.47, 0.0), (0.20, 0.60)),
    "tiago": ((0.70, -0.08), (0.20, 0.25)),
}
START_OFFSETS = {  # paper table 1: 15 % of the working range's limits, joints 1 and 2 [rad]
    "irb120": (0.4319685, 0.287979),
    "tiago": (0.20616675, 0.19962225),
}


TASKS = {  # ours, see docs/decisions.md: home pose [rad] and MPI [rad]
    "irb120": ((0, 0, 0.2, -0.4, -0.28, 1.44), 0.05),
    "tiago": ((0.206, -0.036, -1.35, 1.81, 0.52, 0, 0.95), 0.042),
}


@pytest.fixture(params=["irb120", "tiago"])
def robot(request) -> str:
    return request.param


@pytest.fixture
def scene(robot):
    return load_scene(robot, TARGETS)


def test_joint_ranges_and_axes(robot, scene):
    lower, upper = np.transpose(JOINT_RANGES[robot])
    np.testing.assert_allclose(scene.joint_lower, lower, atol=1e-9)
    np.testing.assert_allclose(scene.joint_upper, upper, atol=1e-9)
    axes = [
        {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}[name] for name in AXES[robot]
    ]
    np.testing.assert_allclose(scene.model.jnt_axis[: len(axes)], axes, atol=1e-12)
    assert scene.num_joints == {"irb120": 6, "tiago": 7}[robot]  # paper 3.2


def test_links(robot, scene):
    for name, (offset, mass) in LINKS[robot].items():
        body = scene.model.body(f"robot/{name}")
        assert body.pos == pytest.approx(offset, abs=1e-9), name
        assert body.mass[0] == pytest.approx(mass, abs=1e-9), name
    if robot == "irb120":
        assert scene.model.body("robot/link_1").mass[0] == pytest.approx(3.067)
        assert scene.model.body("robot/base_link").mass[0] == pytest.approx(6.215)
    else:
        assert scene.model.body("robot/base_link").mass[0] == pytest.approx(
            28.27 + 14.01
        )


def test_episodes_start_where_the_paper_says(robot, scene):
    config = EnvConfig(robot=robot, colours="randomized")
    drawn = evaluation_episodes(config, 4_000, seed=1)
    centre, size = map(np.array, RECTANGLES[robot])
    low, high = centre - size / 2, centre + size / 2
    assert ((drawn.position >= low) & (drawn.position <= high)).all()
    np.testing.assert_allclose(drawn.position.min(0), low, atol=0.002)
    np.testing.assert_allclose(drawn.position.max(0), high, atol=0.002)
    largest = np.abs(drawn.joint_offsets).max(0)
    np.testing.assert_allclose(largest[:2], START_OFFSETS[robot], rtol=2e-3)
    assert not largest[2:].any()
    assert (largest[:2] <= START_OFFSETS[robot]).all()
    shares = np.bincount(drawn.target, minlength=3) / 4_000
    # One of three targets, uniformly
    np.testing.assert_allclose(shares, 1 / 3, atol=0.03)
    np.testing.assert_allclose(drawn.colour.mean(), 0.5, atol=0.03)


def test_colours(scene):
    expected = [  # paper 3.2
        [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)],
        [(1.0, 1.0, 0.0), (0.4, 0.0, 0.9)],
        [(0.55, 0.27, 0.07), (0.5, 0.7, 0.9)],
    ]
    np.testing.assert_allclose(scene.target_colours[..., :3], expected, atol=1e-6)


def test_episode_and_observation(robot):
    config = experiment_config(f"{robot}-full-ppo").env
    assert config.max_episode_steps == 50  # paper table 1
    assert config.image_size == 64  # paper 3.1
    assert config.success_distance_m == 0.05
    assert config.success_angle_deg == 15.0
    assert not config.ignore_roll
    env = ArmVectorEnv(config, 1)
    assert env.single_observation_space.shape == (64, 64, 3)
    assert env.single_observation_space.dtype == np.uint8
    assert (
        env.single_action_space.nvec.tolist() == [7] * {"irb120": 6, "tiago": 7}[robot]
    )


def test_the_time_limit_is_50_steps():
    env = ArmVectorEnv(EnvConfig(image_size=16, dynamics="kinematic"), 1)
    env.reset(seed=0)
    still = np.zeros((1, 6), np.int64)
    ends = [bool(env.step(still)[3][0]) for _ in range(50)]
    assert ends == [False] * 49 + [True]


def test_increments(robot):
    """Paper table 1: 0, +-MPI, +-MPI/10, +-MPI/100, each within the range."""
    config = EnvConfig(robot=robot, image_size=16, dynamics="kinematic", mpi_rad=0.1)
    env = ArmVectorEnv(config, 7)
    env.reset(seed=3)
    before = env.joint_targets.copy()
    levels = np.repeat(np.arange(7)[:, None], before.shape[1], 1)
    env.step(levels)
    moved = (env.joint_targets - before)[:, 2]
    np.testing.assert_allclose(
        sorted(moved), [-0.1, -0.01, -0.001, 0, 0.001, 0.01, 0.1], atol=1e-9
    )
    assert moved[0] == 0.0


@pytest.mark.parametrize("name", TASKS)
def test_home_and_own_increment(name):
    home, mpi = TASKS[name]
    env = ArmVectorEnv(EnvConfig(robot=name, image_size=16, dynamics="kinematic"), 1)
    np.testing.assert_allclose(env.scene.home, home, atol=1e-12)
    env.reset(seed=3)
    before = env.joint_targets.copy()
    env.step(np.ones_like(before, dtype=np.int64))
    np.testing.assert_allclose((env.joint_targets - before)[0, 2:], mpi, atol=1e-9)


@pytest.mark.parametrize(
    ("distance", "angle", "success", "reward"),
    [
        (0.5, 70.0, False, -1.5),  # -2 * .25 - 1
        (0.1, 35.0, False, -0.52),  # -2 * .01 - .5
        (0.04, 14.0, True, 100.0),
    ],
)
def test_reward(distance, angle, success, reward):
    """Paper table 1: 100, or -2 d^2 - a / 70 with d in metres, a in degrees."""
    found = paper_reward(np.array([distance]), np.array([angle]), np.array([success]))
    assert found[0] == pytest.approx(reward)


def test_success_thresholds():
    config = EnvConfig()
    evaluation = EvaluationConfig()
    cases = [
        (0.049, 14.9),
        (0.051, 14.9),
        (0.049, 15.1),
        (0.099, 16.9),
        (0.101, 16.9),
        (0.05, 17.1),
    ]
    distance, angle = np.transpose(cases)
    training = is_success(
        distance, angle, config.success_distance_m, config.success_angle_deg
    )
    assert training.tolist() == [True, False, False, False, False, False]
    after = is_success(distance, angle, evaluation.distance_m, evaluation.angle_deg)
    assert after.tolist() == [True, True, True, True, False, False]


def test_evaluations():
    evaluation = EvaluationConfig()
    assert evaluation.episodes == 1_000  # paper 4.2.4
    assert evaluation.distance_m == 0.10
    assert evaluation.angle_deg == 17.0  # section 4; section 3 says 20
    assert WIDE_ANGLE_DEG == 20.0
    interim = InterimConfig()
    assert interim.every_steps == 50_000  # paper 4.2.3
    assert interim.episodes == 40
    assert experiment_config("irb120-full-a3c").total_steps == 70_000_000


def test_the_papers_analysis_of_variance():
    """Paper 5.4: 30 evaluations of 100 episodes per agent, so F has (1, 58) degrees of freedom."""
    paper = EvaluationConfig(episodes=30 * 100, seeds=30)
    assert paper.episodes // paper.seeds == 100
    generator = np.random.default_rng(0)
    first, second = generator.binomial(100, [[0.9], [0.8]], (2, 30)) / 100
    grand = np.concatenate((first, second)).mean()
    between = 30 * ((first.mean() - grand) ** 2 + (second.mean() - grand) ** 2)
    within = (
        ((first - first.mean()) ** 2).sum() + ((second - second.mean()) ** 2).sum()
    ) / 58
    assert one_way_anova([first, second])[0] == pytest.approx(between / within)


@pytest.mark.parametrize(
    ("experiment", "knowledge", "hidden"),
    [  # paper 4.2.2
        ("irb120-bm-a3c", 0, 128),
        ("irb120-partial-a3c", 150, 278),
        ("irb120-full-a3c", 150, 278),
        ("tiago-full-dr-a3c", 300, 428),
        ("tiago-partial-dr-a3c", 150, 278),
    ],
)
def test_network_widths(experiment, knowledge, hidden):
    config = experiment_config(experiment)
    assert config.knows.known(config.env, 0).table.shape[1] == knowledge
    joints = 7 if experiment.startswith("tiago") else 6
    fusion = config.policy.fusion if knowledge else "none"
    shape = PolicyShape(joints=joints, knowledge_dim=knowledge)
    policy = Policy(PolicyConfig(fusion=fusion, hidden=config.policy.hidden), shape)
    assert policy.hidden_size == hidden
    assert policy.memory.weight_hh.shape == (4 * hidden, hidden)
    assert policy.memory.weight_ih.shape == (4 * hidden, 128 + knowledge)
    assert policy.actor.weight.shape == (joints * 7, hidden)
    assert policy.critic.weight.shape == (1, hidden)


def test_convolutions():
    """Paper 4.2.2: 3x3 stride 4, 5x5 stride 2, 1152 x 128."""
    policy = Policy(PolicyConfig(fusion="none"), PolicyShape(joints=6))
    first, second = policy.encoder.conv1, policy.encoder.conv2
    assert (first.weight.shape, first.stride) == ((16, 3, 3, 3), (4, 4))
    assert (second.weight.shape, second.stride) == ((32, 16, 5, 5), (2, 2))
    image = torch.zeros(1, 3, 64, 64)
    assert second(first(image)).flatten(1).shape == (1, 1152)
    assert policy.fc.weight.shape == (128, 1152)
