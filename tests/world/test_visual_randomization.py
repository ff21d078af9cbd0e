import numpy as np
import pytest

from benchmarks.sim_to_sim import LampRenderer
from knowarm.errors import UserError
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import draw_episodes, evaluation_episodes
from knowarm.world.scene.appearance import VisualRandomization
from knowarm.world.scene.scene import load_scene
from knowarm.world.tasks.held_out import HeldOut
from tests.world.helpers import MakeEnv

TARGETS = ("mug", "bottle", "cereal_box")
EVERYTHING = VisualRandomization(
    light=0.3,
    light_angle_deg=15,
    camera_shift_m=0.05,
    camera_turn_deg=2,
    surface_colour=0.15,
    distractors=3,
)


@pytest.mark.parametrize(
    "randomization",
    [
        VisualRandomization(light=0.5),
        VisualRandomization(light_angle_deg=40),
        VisualRandomization(camera_shift_m=0.1),
        VisualRandomization(camera_turn_deg=4),
        VisualRandomization(surface_colour=0.2),
        VisualRandomization(distractors=4),
    ],
)
def test_each_kind_changes_the_image_and_nothing_else(
    randomization: VisualRandomization, make_env: MakeEnv
) -> None:
    plain = make_env(6, image_size=64)
    varied = make_env(6, image_size=64, randomization=randomization)
    images, infos = plain.reset(seed=3)
    other_images, other_infos = varied.reset(seed=3)
    assert (images != other_images).any(axis=(1, 2, 3)).all()
    for _ in range(3):
        for name in ("distance", "angle", "target", "colour"):
            assert (infos[name] == other_infos[name]).all()
        actions = np.ones((6, 6), dtype=np.int64)
        infos, other_infos = plain.step(actions)[4], varied.step(actions)[4]


@pytest.mark.parametrize("robot", ["irb120", "tiago"])
def test_a_varied_world_is_the_same_at_any_batch_size_and_after_a_stop(
    robot: str, make_env: MakeEnv
) -> None:
    options = {"robot": robot, "randomization": EVERYTHING, "colours": "randomized"}
    one, many, other = (
        make_env(1, **options),
        make_env(5, **options),
        make_env(5, **options),
    )
    alone = one.reset(seed=14)[0]
    together = many.reset(seed=10)[0]
    assert alone[0].tobytes() == together[-1].tobytes()
    assert len({image.tobytes() for image in together}) == 5
    other.set_state(many.get_state())
    actions = np.full(many.action_space.shape, 2)
    for _ in range(55):
        assert many.step(actions)[0].tobytes() == other.step(actions)[0].tobytes()


@pytest.mark.parametrize(
    "randomization",
    [VisualRandomization(light=0.9), VisualRandomization(camera_shift_m=0.2)],
    ids=["light", "camera"],
)
def test_one_image_has_its_own_light_and_camera_everywhere(
    randomization: VisualRandomization, make_env: MakeEnv
) -> None:
    """The floor stands still, so its image could be that of the model's camera and lights."""
    alone = make_env(1, randomization=randomization).reset(seed=14)[0]
    together = make_env(3, randomization=randomization).reset(seed=12)[0]
    assert alone[0].tobytes() == together[-1].tobytes()


def test_distractors_keep_away_from_the_target(make_env: MakeEnv) -> None:
    env = make_env(200, image_size=4, randomization=VisualRandomization(distractors=4))
    env.reset(seed=0)
    places = env.simulation.geom_position[:, env.scene.distractor_geoms, :2]
    target = env.running.positions
    assert np.linalg.norm(places - target, axis=-1).min() > 0.139


@pytest.mark.opengl
def test_the_opengl_renderer_varies_alike(make_env: MakeEnv) -> None:
    pytest.importorskip("OpenGL")
    pairs = []
    for renderer in ("raycast", "opengl"):
        try:
            env = make_env(
                3,
                image_size=64,
                renderer=renderer,
                antialiasing=False,
                randomization=EVERYTHING,
            )
        except UserError as error:
            pytest.skip(str(error))
        pairs.append(env.reset(seed=1)[0].astype(float))
    assert np.abs(pairs[0] - pairs[1]).mean() < 4
    env.renderer = LampRenderer(env.scene, 64)
    darker = pairs[1] - env.reset(seed=1)[0] > 60  # 1.7 %; without shadows nearly none
    assert 0.005 < darker.mean() < 0.1


def test_episodes_of_another_look_are_refused(make_env: MakeEnv) -> None:
    env = make_env(2, randomization=EVERYTHING)
    plain = make_env(2)
    with pytest.raises(UserError, match="draw them with its config"):
        env.reset(options={"episodes": evaluation_episodes(plain.config, 2, 0)})


def test_episodes_in_colours_that_are_not_shown_are_refused(make_env: MakeEnv) -> None:
    many = evaluation_episodes(make_env(8, colours="randomized").config, 8, 0)
    with pytest.raises(
        UserError, match="show colours that this environment does not have"
    ):
        make_env(8).reset(options={"episodes": many})


def test_episodes_of_another_robot_or_other_objects_change_nothing(
    make_env: MakeEnv,
) -> None:
    env = make_env(2, targets=("mug", "bottle"))
    env.reset(seed=1)
    before = env.get_state()
    for options, message in (
        ({"robot": "tiago"}, r"hold 7 joints, and this environment has 6"),
        (
            {"targets": ("mug", "bottle", "cereal_box", "can", "book")},
            r"show other objects than this environment has",
        ),
    ):
        episodes = evaluation_episodes(make_env(2, **options).config, 40, 0)[-2:]
        with pytest.raises(UserError, match=message):
            env.reset(seed=5, options={"episodes": episodes})
    assert (env.get_state()["streams"] == before["streams"]).all()


def test_held_out_places_and_colours_are_never_mixed() -> None:
    scene = load_scene("irb120", TARGETS)
    centre = np.array(scene.robot.rectangle_centre_m)
    half = np.array(scene.robot.rectangle_half_size_m)
    for play in ("rest", "held_out"):
        held_out = HeldOut(
            colours=("blue", "yellow"), places=(0.0, 1.0, -0.5, 1.0), play=play
        )
        config = EnvConfig(colours="randomized", held_out=held_out)
        keys = np.full(3000, 7, np.uint64), np.arange(3000, dtype=np.uint64)
        episodes = draw_episodes(config, *keys)
        offset = (episodes.position - centre) / half
        inside = (offset[:, 0] > 0) & (offset[:, 1] > -0.5)
        assert (inside == (play == "held_out")).all()
        assert offset.min() < -0.45 if play == "held_out" else offset.min() < -0.95
        assert offset.max() > 0.95
        names = [
            scene.colour_names[t][c]
            for t, c in zip(episodes.target, episodes.colour, strict=True)
        ]
        blue_or_yellow = {"blue", "yellow"} & set(names)
        assert blue_or_yellow == ({"blue", "yellow"} if play == "held_out" else set())
        assert {"brown", "light_blue"} <= set(names), "no colour of the box is held out"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: VisualRandomization(light=1.5),
            "light must be between 0 and 1, got 1.5",
        ),
        (
            lambda: VisualRandomization(distractors=9),
            "distractors must be between 0 and 4, got 9",
        ),
        (lambda: HeldOut(), "needs colours or places"),
        (lambda: HeldOut(places=(-1, 1, -1, 1)), "50 % of the rectangle"),
        (lambda: HeldOut(places=(0.5, 0.2, 0, 1)), "x from < x to"),
    ],
)
def test_bad_values_are_named(make, message: str) -> None:
    with pytest.raises(UserError, match=message):
        make()


def test_impossible_held_out_colours_are_refused(make_env: MakeEnv) -> None:
    with pytest.raises(UserError, match="leave target 'mug' no colour"):
        make_env(1, held_out=HeldOut(colours=("red",))).reset(seed=0)
    with pytest.raises(UserError, match="Did you mean 'blue'"):
        make_env(1, colours="randomized", held_out=HeldOut(colours=("blu",))).reset(
            seed=0
        )
