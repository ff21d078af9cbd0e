import numpy as np
import pytest
import torch

from knowarm.deploy.onnx_export import PolicyStep, export_onnx
from knowarm.policy import PolicyAgent
from knowarm.policy.config import FUSIONS
from tests.policy.test_policy import TABLE, B, Still, T, inputs, make_policy

onnxruntime = pytest.importorskip("onnxruntime")
pytest.importorskip("onnxscript")


@pytest.mark.slow
@pytest.mark.parametrize("fusion", ["none", "film", "attention", "similarity"])
def test_onnx_runtime_takes_the_same_actions(tmp_path, fusion):
    assert fusion in FUSIONS  # the others concatenate
    policy = make_policy(fusion, actor_gain=20.0, pixel_shift=0.3, seed=4)
    table = TABLE[:, : policy.knowledge_width]
    step = PolicyStep(policy)
    export_onnx(step, step.example(), tmp_path / "policy.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    agent = PolicyAgent(policy, table, greedy=True)
    agent.reset(Still())
    image = inputs()[0].numpy()
    h, c = (s.numpy() for s in policy.initial_state(B))
    with torch.no_grad():
        expected, values, _ = policy.unroll(
            torch.from_numpy(image),
            torch.from_numpy(table[Still.rows]).expand(T, B, -1),
            policy.initial_state(B),
            torch.tensor([[True] * B] + [[False] * B] * (T - 1)),
        )
    for t in range(T):
        given = {
            "image": image[t],
            "knowledge": table[Still.rows],
            "h": h,
            "c": c,
            "episode_start": np.full(B, t == 0),
        }
        action, logits, value, h, c = session.run(None, given)
        np.testing.assert_array_equal(action, agent.act({"image": image[t]}))
        np.testing.assert_allclose(logits, expected[t].numpy(), rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(value, values[t].numpy(), rtol=1e-4, atol=1e-4)
