"""A recorded step does what an executed one does: on the CPU by a tape, on a GPU by CUDA graphs."""

from typing import Any

import numpy as np
import pytest
import torch
from torch.utils._pytree import tree_flatten_with_path, tree_leaves

from knowarm.world import torch_env
from knowarm.world.held_out import HeldOut
from knowarm.world.step_graph import WARM_UP_STEPS, CudaRecorder, StepGraph
from knowarm.world.visual_randomization import VisualRandomization
from tests.launches import LaunchCounter
from tests.tape import Tape
from tests.world.faces import CUDA, WARP

OPTIONS: list[dict[str, Any]] = [
    {"max_episode_steps": 4},
    {
        "max_episode_steps": 3,
        "dynamics": "kinematic",
        "held_out": HeldOut(places=(0, 1, 0, 1)),
        "randomization": VisualRandomization(
            light=0.3, light_angle_deg=9, camera_shift_m=0.1, surface_colour=0.1, distractors=1
        ),
    },
]

MOST_EXECUTED = 280
"""Operations of a step that is executed one by one."""


def recorded_env(face: Any, recorder: Any = None, **options: Any) -> Any:
    env = face.make(**options)
    if recorder is not None:
        draw = env.renderer.draw
        env.renderer.draw = lambda *args, **kwargs: env.simulation.launch(
            lambda: draw(*args, **kwargs)
        )
        env._graph = StepGraph(env.task, env._play, recorder)
    return env


def assert_equal(one: Any, other: Any) -> None:
    torch.testing.assert_close(one, other, rtol=0, atol=0)


def assert_alike(one: Any, other: Any) -> None:
    """Compare results of a simulation whose solver sums in any order."""
    ours, theirs = (dict(tree_flatten_with_path(each)[0]) for each in (one, other))
    assert ours.keys() == theirs.keys()
    for path, a in ours.items():
        b = theirs[path]
        if a.dtype == torch.uint8:  # an edge may fall on the other side of a sample's ray
            differ = (a != b).any(dim=-1)
            assert int(differ.sum()) <= 0.01 * differ.numel()
        else:
            torch.testing.assert_close(a, b, rtol=0, atol=2e-4)


def play_both(plain: Any, recorded: Any, steps: int) -> None:
    exact = plain.device.type == "cpu" or plain.config.dynamics == "kinematic"
    compare = assert_equal if exact else assert_alike
    generator = torch.Generator().manual_seed(1)
    compare(plain.reset(seed=3), recorded.reset(seed=3))
    truncated, terminated = 0, 0
    for t in range(steps):
        for env in (plain, recorded):
            env.threshold_factor = 20.0 if t > steps // 2 + 2 else 1.0
        actions = torch.randint(7, (6, 6), generator=generator).to(plain.device)
        if t == steps // 2:
            options = {"reset_mask": np.arange(6) % 2 == 0}
            compare(plain.reset(options=options), recorded.reset(options=options))
        one, other = plain.step(actions), recorded.step(actions)
        final, other_final = (step[4].pop("final_obs") for step in (one, other))
        compare(one, other)
        compare(final[one[3]], other_final[one[3]])
        truncated, terminated = truncated + int(one[3].sum()), terminated + int(one[2].sum())
    assert truncated >= 6
    assert terminated
    compare(plain.facet_ids, recorded.facet_ids)
    compare(plain.joint_positions, recorded.joint_positions)
    one, other = plain.get_state(), recorded.get_state()
    if not exact:  # velocities and accelerations
        del one["simulation"], other["simulation"]
    for name, values in one.items():
        tolerance = 0 if exact else 2e-4
        np.testing.assert_allclose(values, other[name], rtol=0, atol=tolerance, err_msg=name)


@pytest.mark.parametrize("options", OPTIONS, ids=["plain", "varied"])
def test_a_replayed_step_is_the_executed_step(options: dict[str, Any]) -> None:
    plain, recorded = recorded_env(WARP, **options), recorded_env(WARP, Tape(), **options)
    play_both(plain, recorded, WARM_UP_STEPS + 12)
    first = recorded._graph._recorded
    assert first is not None
    plain.report_privileged_state = recorded.report_privileged_state = True
    play_both(plain, recorded, WARM_UP_STEPS + 12)
    assert recorded._graph._recorded is not first
    assert recorded._graph._recorded is not None


@pytest.mark.parametrize("face", [pytest.param(CUDA, marks=pytest.mark.cuda)], ids=["cuda"])
@pytest.mark.parametrize("options", OPTIONS, ids=["plain", "varied"])
def test_a_cuda_graph_of_a_step_is_the_executed_step(face: Any, options: dict[str, Any]) -> None:
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    plain, recorded = recorded_env(face, **options), recorded_env(face, **options)
    plain._graph = None
    assert isinstance(recorded._graph._recorder, CudaRecorder)
    play_both(plain, recorded, WARM_UP_STEPS + 12)
    assert recorded._graph._recorded is not None


def test_outputs_of_a_replay_are_not_overwritten_by_the_next() -> None:
    env = recorded_env(WARP, Tape())
    env.reset(seed=0)
    stay = torch.zeros((6, 6), dtype=torch.int64)
    for _ in range(WARM_UP_STEPS + 1):
        env.step(stay)
    kept = env.step(stay)
    before = [leaf.clone() for leaf in tree_leaves(kept) if leaf is not kept[4]["final_obs"]]
    env.step(stay + 1)
    after = [leaf for leaf in tree_leaves(kept) if leaf is not kept[4]["final_obs"]]
    assert_equal(before, after)


def test_a_step_that_cannot_be_recorded_is_executed() -> None:
    class Refusing(Tape):
        def record(self, run: Any) -> list[Any]:
            recorded.task.steps = torch.empty(6, device="meta")  # as an aborted capture leaves it
            raise RuntimeError("operation not permitted when stream is capturing")

    plain = recorded_env(WARP, max_episode_steps=4)
    recorded = recorded_env(WARP, Refusing(), max_episode_steps=4)
    with pytest.warns(RuntimeWarning, match=r"could not be recorded.*not permitted") as seen:
        play_both(plain, recorded, WARM_UP_STEPS + 6)
    assert len(seen) == 1


class CountingCuts(Tape):
    """Executes nothing and counts the launches of Warp's graphs in a step."""

    executes = False
    cuts = 0

    def record(self, run: Any) -> list[Any]:
        run()
        return []

    def cut(self, launch: Any) -> None:
        self.cuts += 1


def test_final_images_are_drawn_only_where_wanted() -> None:
    steps, drawn = {}, []
    for wanted in (True, False):
        env = recorded_env(WARP, Tape(), max_episode_steps=3)
        draw = env.renderer.draw

        def note(*args: Any, draw: Any = draw, **options: Any) -> None:
            drawn.append(options.get("wanted") is not None)
            draw(*args, **options)

        env.renderer.draw = note
        env.report_final_observations = wanted
        env.reset(seed=0)
        stay = torch.zeros((6, 6), dtype=torch.int64)
        steps[wanted] = [env.step(stay) for _ in range(WARM_UP_STEPS + 4)]
        assert any(drawn) == wanted
        drawn.clear()
    for one, other in zip(steps[True], steps[False], strict=True):
        assert one[4].keys() - other[4].keys() == {"final_obs", "_final_obs"}
        assert_equal(one[:4], other[:4])


@pytest.mark.parametrize("options", OPTIONS, ids=["plain", "varied"])
def test_a_replayed_step_launches_little(
    options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    env, recorder = WARP.make(**options), CountingCuts()
    monkeypatch.setattr(env.renderer, "draw", lambda *args, **kwargs: None)
    monkeypatch.setattr(torch_env, "check_actions", lambda *args: None)
    env._graph = StepGraph(env.task, env._play, recorder)
    env.reset(seed=0)
    stay = torch.zeros((6, 6), dtype=torch.int64)
    with LaunchCounter() as executed:
        env.step(stay)
    for _ in range(WARM_UP_STEPS):
        env.step(stay)
    assert recorder.cuts == 2, "CUDA graphs of torch alternate with these: five launches"
    with LaunchCounter() as replayed:
        env.step(stay)
    assert executed.total <= MOST_EXECUTED
    # The actions are copied into the graph; images, numbers, indices and flags out of it.
    assert replayed.seen == {"copy_.default": 1, "clone.default": 4}
