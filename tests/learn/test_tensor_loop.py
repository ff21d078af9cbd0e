"""PPO on an environment of tensors takes the steps that it takes on one of arrays."""

import dataclasses

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.learn import CheckpointStore, Hooks, PPOConfig, PPOTrainer
from knowarm.learn.evaluation import MOST_WAITING, BackgroundEvaluations, InlineEvaluations
from knowarm.learn.guards import NotFiniteError
from knowarm.learn.precision import resolve_precision
from knowarm.learn.tensor_collector import TensorCollector
from knowarm.policy import Policy, PolicyConfig
from tests.learn.toys import JOINTS, LEVELS, SIDE, ToyEnv

TABLE = np.zeros((1, 1), np.float32)
CONFIG = PPOConfig(
    num_envs=8, rollout_steps=12, epochs=2, minibatches=2, matmul_precision="float32", processes=1
)


def policy(seed=0):
    sizes = {"joints": JOINTS, "levels": LEVELS, "image_size": SIDE, "features": 16}
    return Policy(PolicyConfig(**sizes, fusion="none"), seed=seed)


class Staggered(ToyEnv):
    """A toy whose environments end at different steps."""

    def reset(self, **options):
        observation, infos = super().reset(**options)
        self._clock = np.arange(self.num_envs) % self.length
        return observation, infos


class TensorToy:
    """A toy environment that takes and gives tensors."""

    device = torch.device("cpu")

    def __init__(self, toy):
        self.toy, self.num_envs, self.max_episode_steps = toy, toy.num_envs, toy.length

    @property
    def facet_ids(self):
        return torch.from_numpy(self.toy.facet_ids)

    def reset(self, **options):
        return torch.from_numpy(self.toy.reset(**options)[0].copy()), {}

    def step(self, actions):
        observation, reward, terminated, truncated, infos = self.toy.step(actions.numpy())
        infos = {
            "final_obs": torch.from_numpy(infos["final_obs"].copy()),
            "final_info": {k: torch.from_numpy(v) for k, v in infos["final_info"].items()},
        }
        tensors = observation.copy(), reward.astype(np.float32), terminated, truncated
        return *map(torch.from_numpy, tensors), infos

    def get_state(self):
        return self.toy.get_state()

    def set_state(self, state):
        self.toy.set_state(state)


def train(env, steps=12 * 8 * 4, **parts):
    trained, rows = policy(), []
    hooks = Hooks(on_metrics=rows.append)
    trainer = PPOTrainer(CONFIG, trained, env, TABLE, seed=3, hooks=hooks, **parts)
    trainer.train(steps)
    return trainer, trained, rows


@pytest.mark.parametrize("recall", [False, True])
@pytest.mark.parametrize("length", [5, 12, 20])
def test_tensors_and_arrays_train_the_same_policy(recall, length):
    made = [Staggered(8, recall=recall, length=length) for _ in range(2)]
    (_, one, rows), (_, other, tensor_rows) = train(made[0]), train(TensorToy(made[1]))
    for name, tensor in one.state_dict().items():
        # Where episodes are cut, values are computed in other batches, which round differently.
        tolerance = 0.0 if recall else 1e-6
        torch.testing.assert_close(tensor, other.state_dict()[name], rtol=0, atol=tolerance)
    for row, other_row in zip(rows, tensor_rows, strict=True):
        for name in ("episodes", "return_mean", "length_mean", "success", "value_loss"):
            assert row.get(name) == pytest.approx(other_row.get(name)), name


def test_the_tensor_loop_is_used_and_values_what_was_cut():
    trainer, _, _ = train(TensorToy(Staggered(8, recall=False, length=5)), steps=96)
    assert isinstance(trainer._collector, TensorCollector)
    rollout = trainer._learner.rollout
    assert torch.equal(rollout.final_value != 0, rollout.truncated)
    assert rollout.truncated.sum() > 8


def test_stop_and_resume_give_the_same_bytes(tmp_path):
    def run(folder, stop_after=None, resume=False):
        rows, trained = [], policy()
        hooks = Hooks(on_metrics=rows.append, should_stop=lambda: len(rows) == stop_after)
        env = TensorToy(Staggered(8, recall=False, length=5))
        store = CheckpointStore(folder, {"robot": "toy"})
        trainer = PPOTrainer(CONFIG, trained, env, TABLE, seed=3, hooks=hooks, checkpoints=store)
        if resume:
            trainer.resume()
        trainer.train(96 * 4)
        return trained.state_dict()

    whole = run(tmp_path / "whole")
    run(tmp_path / "cut", stop_after=2)
    resumed = run(tmp_path / "cut", resume=True)
    for name, tensor in whole.items():
        assert torch.equal(tensor, resumed[name])


def test_a_gradient_that_is_not_finite_stays_out_of_the_parameters_on_a_device():
    trainer, trained, _ = train(TensorToy(Staggered(8, recall=False, length=5)), steps=96)
    trainer._device = torch.device("meta")  # what a GPU does, which is not waited for
    before = {name: tensor.clone() for name, tensor in trained.state_dict().items()}
    loss = trainer._learner.differentiate(torch.arange(4))
    trainer._learner.gradient[3] = float("nan")
    norm = trainer._descend(loss)
    assert all(torch.isfinite(tensor).all() for tensor in trained.state_dict().values())
    assert any(not torch.equal(t, before[n]) for n, t in trained.state_dict().items())
    with pytest.raises(NotFiniteError, match="the gradient's norm"):
        trainer._guard.check_updates([loss], [norm], 96, trainer._learner.rollout)


def length_of_parameters(judged):
    return {"return_mean": float(sum(p.detach().square().sum() for p in judged.parameters()))}


def make_length():
    return length_of_parameters


def dying(judged):
    raise SystemExit(3)


def make_dying():
    return dying


@pytest.mark.slow
def test_evaluations_in_the_background_are_those_in_line():
    results = []
    for evaluations in (
        InlineEvaluations(length_of_parameters),
        BackgroundEvaluations(policy(), make_length),
    ):
        for step in range(MOST_WAITING + 3):
            evaluations.ask(step, policy(seed=step))
        results.append(evaluations.finished(wait=True))
        evaluations.end()
    assert len(results[0]) == MOST_WAITING + 3
    for inline, background in zip(*results, strict=True):
        assert inline.step == background.step
        assert inline.results == pytest.approx(background.results)
        for name, array in inline.policy.items():
            np.testing.assert_array_equal(array, background.policy[name])


@pytest.mark.slow
def test_training_with_evaluations_in_the_background_keeps_the_same_best_policy(tmp_path):
    best = []
    for name, parts in (
        ("inline", {"evaluate": length_of_parameters}),
        ("background", {"make_evaluate": make_length}),
    ):
        store = CheckpointStore(tmp_path / name, {})
        env = Staggered(8, recall=False, length=5)
        trainer, _, _ = train(env, evaluate_every=96, checkpoints=store, **parts)
        best.append((trainer.best.step, store.load_best().facts["return_mean"]))
    assert best[0] == pytest.approx(best[1])


@pytest.mark.slow
def test_an_evaluator_that_dies_is_named():
    evaluations = BackgroundEvaluations(policy(), make_dying)
    evaluations.ask(0, policy())
    with pytest.raises(RuntimeError, match="The evaluator ended with exit code 3"):
        evaluations.finished(wait=True)
    evaluations.end()


def test_precisions_and_processes_of_the_other_device_are_refused():
    with pytest.raises(UserError, match="'tf32' is a GPU's"):
        resolve_precision("tf32", torch.device("cpu"))
    with pytest.raises(UserError, match="processes"):
        dataclasses.replace(CONFIG, device="cuda", processes=2)


def test_a_full_gpu_is_said_with_the_remedy():
    class Full(TensorToy):
        def step(self, actions):
            raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.")

    with pytest.raises(
        UserError, match=r"memory was full at step 0 with 8 environments.*2\.00 GiB"
    ):
        train(Full(Staggered(8, recall=False, length=5)))


def test_an_environment_that_is_not_on_the_gpu_asked_for_is_refused():
    config = dataclasses.replace(CONFIG, device="cuda", processes=None)
    env = ToyEnv(8, recall=False, length=5)
    with pytest.raises(UserError, match="device is 'cuda' and the environment is on cpu"):
        PPOTrainer(config, policy(), env, TABLE, seed=0)
