"""Grounding network: what it is trained on, what it selects, its file, and runs that have one."""

import copy
import dataclasses
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.experiment.load import load_agent
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import build, train
from knowarm.experiment.run_folder import PERCEPTION_FILE, network_for_training
from knowarm.perception import grounding_training
from knowarm.perception.config import GroundingConfig, GroundingSpec
from knowarm.perception.grounding import (
    FRAME,
    STRIDE,
    WIDTH,
    GroundingNetwork,
    centres,
    place_of,
)
from knowarm.perception.grounding_training import train_grounding
from knowarm.perception.images import ImageSampler, query_answers, sample_images
from knowarm.perception.recognition import FrameRecognition
from knowarm.reading import UnreadableFileError
from knowarm.world.cache import cache_file
from knowarm.world.config import facets_of, questions_of
from knowarm.world.envs.vector_env import ArmVectorEnv
from tests.tiny import CHOOSE, CHOOSE_ENV, CHOOSE_NAME


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    """An empty cache of networks; other caches stay."""
    folder = tmp_path / "cache"
    monkeypatch.setattr(
        grounding_training,
        "cache_file",
        lambda *parts: folder / Path(cache_file(*parts)).name,
    )
    return folder


@pytest.fixture(scope="module")
def config():
    return experiment_config(CHOOSE_NAME, **CHOOSE)


@pytest.fixture(scope="module")
def network(config):
    parts = build(config)
    return GroundingNetwork(
        GroundingSpec.of(config.env, GroundingConfig()),
        parts.knowledge.table,
        parts.knowledge.embedding.slots_per_row,
    )


@pytest.fixture(scope="module")
def labels(config, network):
    return sample_images(config.env, network.spec, 96, seed=3)


def test_places_cover_the_image_row_by_row():
    points = centres(64)
    side, half = 64 // STRIDE, STRIDE / 2
    assert points[1].tolist() == [3 * half, half]
    assert points[side].tolist() == [half, 3 * half]
    assert place_of(points, 64).tolist() == list(range(len(points)))
    assert place_of(torch.tensor([[-3.0, 70.0]]), 64).tolist() == [side * (side - 1)]


def test_the_labels_are_where_the_objects_are_seen():
    """In the marked image the wanted object is the only magenta one."""
    config = experiment_config("irb120-choose-mask-fast", env=CHOOSE_ENV)
    spec = GroundingSpec.of(config.env, GroundingConfig())
    found = sample_images(config.env, spec, 64, seed=0)
    image = found.images.float()
    magenta = (image[..., 0] - image[..., 1]).clamp(min=0) * (
        image[..., 2] - image[..., 1] > 40
    )
    line = torch.arange(64) + 0.5
    total = magenta.sum((1, 2)).clamp(min=1)
    column = (magenta * line).sum((1, 2)) / total
    row = (magenta * line[:, None]).sum((1, 2)) / total
    away = (found.pixels[:, 0] - torch.stack((column, row), 1)).norm(dim=1)
    assert away.median() < 4
    others = (found.pixels[:, 1:] - torch.stack((column, row), 1)[:, None]).norm(dim=2)
    assert (away < others.min(1).values).float().mean() > 0.95


def test_labels_are_the_grasp_frames_of_the_simulator(config, network, labels):
    world = ArmVectorEnv(config.env, 96)
    images, infos = world.reset(seed=3)
    assert (labels.images.numpy() == images).all()
    np.testing.assert_allclose(
        labels.grasp_position[:, 0], world.running.goal_position, atol=1e-6
    )
    axes = (
        world.running.goal_matrix.reshape(-1, 3, 3)[:, :, [0, 2]]
        .swapaxes(1, 2)
        .reshape(-1, 6)
    )
    np.testing.assert_allclose(labels.grasp_axes[:, 0], axes, atol=1e-6)
    places = infos["object_positions"]
    np.testing.assert_allclose(
        labels.grasp_position.numpy()[..., :2]
        - world.scene.grasp_position[infos["objects"]][..., :2],
        places,
        atol=1e-6,
    )


def test_every_draw_shows_new_episodes(config, network):
    source = ImageSampler(config.env, network.spec, 3, at_once=32)
    first, second = source.sample(64), source.sample(40)
    assert len(second.images) == 40
    shown = torch.cat((first.images, second.images)).flatten(1)
    assert len(shown.unique(dim=0)) == 104


def test_a_marked_image_answers_for_the_marked_object_only(config, network, labels):
    asked = dataclasses.replace(config.env.task.asked, marked=True)
    task = dataclasses.replace(config.env.task, asked=asked)
    env = dataclasses.replace(config.env, task=task)
    answers = query_answers(env, network.spec.facets)
    row = torch.tensor([5])
    means_others = [
        query
        for query in range(49)
        if answers.satisfies[query, labels.facets[5, 1:]].sum() == 1
        and not answers.satisfies[query, labels.facets[5, 0]]
    ]
    assert means_others
    with torch.no_grad():
        others, own = torch.tensor(means_others), labels.queries[5:6]
        shown = labels.of(row)
        features = network.features(shown.images)
        for queries, is_asked in ((others, False), (own, True)):
            known = network.knowledge[queries]
            loss = network.place_loss(features, shown, known, answers.of(queries))
            assert (loss > 0) == is_asked


def test_the_losses_are_those_of_a_plain_loop(config, network, labels):
    answers = query_answers(config.env, network.spec.facets)
    rows, queries = torch.arange(0, 96, 7), torch.arange(0, 49, 3)
    table, facets = questions_of(config.env), network.spec.facets
    column = {facets.index(facet): number for number, facet in enumerate(table.facets)}
    errors, named, frames = [], [], []
    with torch.no_grad():
        some = labels.of(rows)
        features = network.features(some.images)
        place = network.place_loss(
            features, some, network.knowledge[queries], answers.of(queries)
        )
        naming, frame = network.recognition_losses(features, some)
        for row in rows.tolist():
            features = network.encoder.features(labels.images[row][None])
            shown = [column[facet] for facet in labels.facets[row].tolist()]
            for query in queries.tolist():
                shown_answers = [
                    i for i, f in enumerate(shown) if table.satisfies[query, f]
                ]
                if (
                    len(shown_answers) != 1
                    or not table.askable[query, shown[shown_answers[0]]]
                ):
                    continue
                wanted = network.project_queries(network.knowledge[query][None])[0]
                scores = (network.keys(features)[0] @ wanted).log_softmax(0)
                errors.append(
                    -scores[place_of(labels.pixels[row, shown_answers[0]], 64)]
                )
            objects, colours = network.encoder.logits(features)
            of, hue = network.encoder.facet_parts
            names = (
                (objects[0, of] + colours[0, hue])
                .flatten()
                .log_softmax(0)
                .view(len(of), -1)
            )
            where = place_of(labels.pixels[row], 64)
            named.append(-names[labels.facets[row], where].mean())
            for i, pixel in enumerate(labels.pixels[row]):
                truth = torch.cat(
                    (labels.grasp_position[row, i], labels.grasp_axes[row, i])
                )
                found = network.frames(features, place_of(pixel, 64).view(1, 1))[0, 0]
                frames.append((found - truth).square().mean())
    assert len(errors) > 20
    torch.testing.assert_close(place, torch.stack(errors).mean(), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(frame, torch.stack(frames).mean(), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(naming, torch.stack(named).mean(), rtol=1e-4, atol=1e-4)


def test_names_are_sums_over_places(network, labels):
    """The product of matrices equals the logarithm of the sum of exponentials, also if small."""
    with torch.no_grad():
        features = 20 * network.encoder.features(labels.images[:4])
        objects, colours = network.encoder.logits(features)
        object_of, colour_of = network.encoder.facet_parts
        objects, colours = objects[:, object_of], colours[:, colour_of]
        expected = torch.logsumexp(objects + colours, dim=2)
        found = network.encoder.facet_scores(features)
    likely = expected > expected.max(1, keepdim=True).values - 60
    torch.testing.assert_close(found[likely], expected[likely], rtol=1e-4, atol=1e-3)
    assert found.isfinite().all()


def test_training_lowers_the_loss_of_places_and_repeats_to_the_byte(
    config, empty_cache
):
    parts = build(config)
    lines = []
    arguments = (
        config.env,
        parts.knowledge.table,
        parts.knowledge.embedding.slots_per_row,
    )
    settings = GroundingConfig(images=128, rounds=8, batch=32)
    trained = train_grounding(*arguments, settings, seed=1, report=lines.append)
    assert not any(each.requires_grad for each in trained.parameters())
    for name, share in (("grounding, round", 0.85), ("frame head, epoch", 0.7)):
        losses = [float(line.rsplit(" ", 1)[1]) for line in lines if name in line]
        assert losses[-1] < share * losses[0]
    hasty = dataclasses.replace(settings, images=64, rounds=2)
    first, other = (
        train_grounding(*arguments, hasty, seed=i).to_bytes() for i in (1, 2)
    )
    for file in empty_cache.iterdir():
        file.unlink()
    assert train_grounding(*arguments, hasty, seed=1).to_bytes() == first != other
    assert train_grounding(*arguments, hasty, seed=3, should_stop=lambda: True) is None
    asked, one = [], dataclasses.replace(hasty, rounds=1)
    stop = {"seed": 3, "should_stop": lambda: asked.append(0) or len(asked) > 1}
    assert train_grounding(*arguments, one, **stop) is None, "stopped within a round"


@pytest.mark.parametrize("shared", [0, 2])
def test_a_stopped_training_continues_with_its_round_as_if_it_had_not_been_stopped(
    config, empty_cache, shared
):
    parts = build(config)
    settings = GroundingConfig(images=64, rounds=3, batch=32, shared_rounds=shared)
    arguments = (
        config.env,
        parts.knowledge.table,
        parts.knowledge.embedding.slots_per_row,
        settings,
    )
    whole = train_grounding(*arguments, seed=0).to_bytes()
    for file in empty_cache.rglob("*.npz"):
        file.unlink()
    lines, rounds = [], shared + 3

    def stop_in_the_last_round() -> bool:
        return sum("grounding, round" in line for line in lines) == rounds - 1

    options = {"seed": 0, "report": lines.append}
    assert (
        train_grounding(*arguments, **options, should_stop=stop_in_the_last_round)
        is None
    )
    lines.clear()
    assert train_grounding(*arguments, **options).to_bytes() == whole
    seen = [line for line in lines if line.startswith("grounding, round")]
    assert [line.partition(":")[0][-6:] for line in seen] == ["2 of 3", "3 of 3"]
    assert seen[0].endswith("done before")
    assert not list(empty_cache.rglob("*.part.npz"))


def test_agents_share_names_and_frames_and_a_cached_network_is_the_trained_one(
    config, empty_cache
):
    parts, lines = build(config), []
    table, slots = parts.knowledge.table, parts.knowledge.embedding.slots_per_row
    settings = GroundingConfig(images=64, rounds=1, batch=32, shared_rounds=1)

    def train(knowledge, **options):
        found = train_grounding(
            config.env,
            knowledge,
            slots,
            settings,
            seed=0,
            report=lines.append,
            **options,
        )
        return None if found is None else found.state_dict()

    def differing(one, other):
        return {
            n.split(".")[0]
            for n in one
            if n != "knowledge" and (one[n] != other[n]).any()
        }

    first, other = train(table), train(table[::-1].copy())
    assert differing(first, other) == {"key", "query"}
    assert [line.startswith("training") for line in lines if "(" in line] == [
        1,
        1,
        1,
        0,
        1,
        0,
    ]
    untrained = GroundingNetwork(
        GroundingSpec.of(config.env, settings), table, slots
    ).state_dict()
    assert {"encoder", "frame", "key", "query"} <= differing(first, untrained)
    assert differing(train(table), first) == set()
    assert all("read from" in line for line in lines[-3:])
    # Nothing is left to train
    assert train(table, should_stop=lambda: True) is not None
    for file in empty_cache.iterdir():
        file.write_bytes(b"damaged")
    assert differing(train(table), first) == set()
    assert "read from" not in lines[-1]
    assert train(table + 1, should_stop=lambda: True) is None


def test_other_objects_seeds_and_settings_are_other_networks(config, empty_cache):
    parts = build(config)
    settings = GroundingConfig(images=32, rounds=0, batch=32, shared_rounds=1)
    fewer = dataclasses.replace(config.env, targets=config.env.targets[:-1])
    hasty = dataclasses.replace(settings, learning_rate=0.1)
    for env, how, seed in (
        (config.env, settings, 0),
        (config.env, settings, 1),
        (config.env, hasty, 0),
        (fewer, settings, 0),
    ):
        train_grounding(env, parts.knowledge.table, 1, how, seed=seed)
    assert len([*empty_cache.iterdir()]) == 2 * 4  # names and frames, and their head


def test_runs_share_a_network_whose_seed_is_given(config, empty_cache):
    parts = build(config)
    settings = GroundingConfig(images=32, rounds=1, batch=32)
    given = dataclasses.replace(settings, seed=3)

    def train(how, seed):
        return train_grounding(
            config.env, parts.knowledge.table, 1, how, seed=seed
        ).state_dict()

    first, again, own = train(given, 0), train(given, 1), train(settings, 3)
    assert len([*empty_cache.iterdir()]) == 2  # network and frame head
    for other in (again, own):
        assert all(torch.equal(first[name], value) for name, value in other.items())
    assert not torch.equal(train(settings, 0)["key.0.weight"], first["key.0.weight"])


@torch.no_grad()
def test_a_frame_is_predicted_from_the_places_around_it(network):
    wide = network
    narrow = GroundingNetwork(
        network.spec, network.knowledge, network.slots, first_stage=True
    )
    generator = torch.Generator().manual_seed(0)
    features = torch.rand(2, 64, 16, 16, generator=generator)
    places = torch.tensor([[0, 17], [255, 100]])
    found = wide.frame_inputs(features, places)
    around = torch.nn.functional.unfold(features, 3, padding=1)
    for row, image in enumerate(around):
        assert torch.equal(found[row, :, :-2], image[:, places[row]].T)
        assert torch.equal(
            narrow.frame_inputs(features, places)[row, :, :-2],
            features[row].flatten(1)[:, places[row]].T,
        )
    again = GroundingNetwork.from_bytes(wide.to_bytes())
    assert torch.equal(again.frames(features, places), wide.frames(features, places))


@torch.no_grad()
def test_a_slot_of_zeros_is_no_condition(network):
    two, slot = GroundingNetwork(network.spec, torch.ones(1, 100), 2), torch.ones(50)
    rows = torch.zeros(3, 2, 50)
    rows[0, 0] = rows[1, 1] = slot
    wanted = two.project_queries(rows.flatten(1))
    torch.testing.assert_close(wanted[0], wanted[1])
    torch.testing.assert_close(wanted[0], two.query(slot) / WIDTH**0.5)
    torch.testing.assert_close(wanted[2], two.query(0 * slot) / WIDTH**0.5)


def environments(config, network):
    """Return training environments whose knowledge is what a network finds."""
    knowledge = config.knows.known(config.env, config.seed, network=network)
    return knowledge.make_env(config.env, 6, num_threads=1)


def test_the_policy_receives_the_frame_found_in_the_first_image(config, network):
    env = environments(config, network)
    images, _ = env.reset(seed=0)
    first = FrameRecognition(network)(images, env.knowledge_input)
    assert first.shape == (6, FRAME)
    assert torch.equal(env.knowledge, first)
    for _ in range(3):
        env.step(torch.zeros(6, env.scene.num_joints, dtype=torch.int64))
    assert torch.equal(env.knowledge, first)
    other = environments(config, network)
    other.reset(seed=1)
    state = env.get_state()
    other.set_state(state)
    assert torch.equal(other.knowledge, first)
    with pytest.raises(UserError, match="what was recognized"):
        other.set_state(
            {name: value for name, value in state.items() if name != "perceived"}
        )
    parts = build(config)
    assert parts.knowledge.table.shape[0] == 49
    policy = parts.new_policy(0)
    policy.check_knowledge(first)
    with pytest.raises(UserError, match="expects vectors of 9 float32 numbers"):
        policy.check_knowledge(torch.zeros(6, 50))


def test_a_teacher_goes_with_the_true_frame(config, network):
    env = environments(config, network)
    env.reset(seed=0)
    env.practice_share = 1.0
    env.reset()
    frames, running = env.knowledge, env.running
    position = frames[:, :3] * network.position_std + network.position_mean
    assert np.allclose(position, running.goal_position, atol=1e-6)
    matrix = running.goal_matrix.reshape(-1, 3, 3)
    assert np.allclose(frames[:, 3:6], matrix[:, :, 0])
    assert np.allclose(frames[:, 6:], matrix[:, :, 2])


def test_an_arm_is_trained_with_a_network_that_exists(tmp_path, choose_run):
    network = choose_run.folder.path / PERCEPTION_FILE
    changes = {
        **CHOOSE,
        "total_steps": 8,
        "algorithm": {"num_envs": 4, "minibatches": 2},
    }
    run = train("irb120-choose-answers-distil", tmp_path, perception=network, **changes)
    assert (run.folder.path / PERCEPTION_FILE).read_bytes() == network.read_bytes()
    trained = load_agent(run.folder.path)
    assert trained.network.to_bytes() == network.read_bytes()
    assert load_agent(run.folder.path, perception=network).policy is not None
    with pytest.raises(UserError, match="was trained with other knowledge"):
        train(
            "irb120-choose-query-onehot-distil", tmp_path, perception=network, **changes
        )
    with pytest.raises(
        UserError, match="for the robot irb120, and this task has tiago"
    ):
        train("tiago-choose-answers-distil", tmp_path, perception=network, **changes)
    assert len(list(tmp_path.glob("*-choose-*"))) == 1


def test_a_network_knows_one_of_the_objects_that_look_alike(tmp_path):
    config = experiment_config("irb120-families-answers-distil")
    spec = GroundingSpec.of(config.env, config.knows.grounding)
    GroundingNetwork(spec, np.zeros((1, 4), np.float32), 1).write(
        tmp_path / PERCEPTION_FILE
    )
    given = network_for_training(config, None, tmp_path / PERCEPTION_FILE)
    assert len(given.spec.facets) < len(facets_of(config.env))


def test_the_file_holds_the_network_and_its_table(network, labels):
    again = GroundingNetwork.from_bytes(network.to_bytes())
    assert isinstance(again, GroundingNetwork)
    assert torch.equal(again.knowledge, network.knowledge)
    known = network.knowledge[labels.queries[:8]]
    assert torch.equal(
        again(labels.images[:8], known), network(labels.images[:8], known)
    )
    for sent in (pickle.loads(pickle.dumps(network)), copy.deepcopy(network)):
        assert sent.to_bytes() == network.to_bytes()
        assert not sent.training


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: data[:-40], "damaged or of another format"),
        (lambda data: b"", "damaged or of another format"),
        (lambda data: data.replace(b"grounding-2", b"grounding-9"), "expected .*-2"),
        (lambda data: data.replace(b"mug", b"mag", 1), "do not fit the facets"),
        (lambda data: data[:-4] + b"\xff\xff\xff\x7f", "non-finite"),
    ],
)
def test_a_damaged_file_is_one_kind_of_error(network, tmp_path, damage, message):
    path = tmp_path / PERCEPTION_FILE
    path.write_bytes(damage(network.to_bytes()))
    with pytest.raises(UnreadableFileError, match=message):
        GroundingNetwork.read(path)


def test_a_network_is_given_only_where_it_is_used_and_exists(tmp_path):
    for name, message in (
        ("irb120-bm-ppo", "leave perception out"),
        (CHOOSE_NAME, "Cannot read"),
    ):
        with pytest.raises(UserError, match=message):
            train(
                name, tmp_path, perception=tmp_path / "none.safetensors", total_steps=8
            )
    assert not list(tmp_path.glob("irb120*"))


def test_a_run_refuses_a_network_that_is_not_its_own(
    tmp_path, network, copy_of, choose_run
):
    run, other = copy_of(choose_run), tmp_path / "other.safetensors"
    network.write(other)
    config = run.experiment()
    with pytest.raises(UserError, match="trained with another grounding network"):
        network_for_training(config, run, other)
    (run.path / PERCEPTION_FILE).write_bytes(other.read_bytes())
    with pytest.raises(
        UnreadableFileError, match="not the network that this run was trained with"
    ):
        load_agent(run.path)


def test_a_run_keeps_its_network_and_resumes_to_the_byte(tmp_path, choose_run, config):
    whole = choose_run
    kept = (whole.folder.path / PERCEPTION_FILE).read_bytes()
    # Stopped while the network is trained, then between two updates.
    asked = []
    stopped = train(
        config, tmp_path / "cut", should_stop=lambda: asked.append(0) or len(asked) > 1
    )
    assert (stopped.result.reason, stopped.result.step) == ("stopped", 0)
    rows = tmp_path / "cut" / CHOOSE_NAME / "0" / "metrics.csv"
    stopped = train(config, tmp_path / "cut", resume=True, should_stop=rows.exists)
    assert stopped.result.reason == "stopped"
    resumed = train(config, tmp_path / "cut", resume=True)
    assert (resumed.folder.path / PERCEPTION_FILE).read_bytes() == kept
    for part in ("policy", "optimizer", "state"):
        name = f"checkpoints/latest/{part}.safetensors"
        one, two = (run.folder.path / name for run in (whole, resumed))
        assert one.read_bytes() == two.read_bytes()
    agent = load_agent(resumed.folder.path).agent
    assert isinstance(agent.recognition, FrameRecognition)
    assert resumed.folder.provenance().perception["config"]["images"] == 64


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *((name, 0) for name in ("images", "batch", "learning_rate", "rounds")),
        ("naming_coef", -1.0),
        ("shared_rounds", -1),
        ("seed", -1),
        ("channels", 0),
        ("channels", 66),
    ],
)
def test_numbers_out_of_range_are_refused(field, value):
    with pytest.raises(UserError, match=field):
        GroundingConfig(**{field: value})
