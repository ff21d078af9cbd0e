"""Optimizers: which parameters Muon updates, its products, and its update."""

import pytest
import torch

from knowarm.learn import PPOConfig
from knowarm.learn import optimizer as optimizer_module
from knowarm.learn.learner import TrainingNetwork
from knowarm.learn.optimizer import (
    MUON_PARAMETERS,
    Float32Muon,
    PolicyOptimizer,
    orthogonalized,
)
from tests.learn.toys import toy_policy


@pytest.mark.parametrize("choice", ["muon", "muon-float32"])
def test_muon_updates_its_matrices_and_adam_the_rest(choice):
    network = TrainingNetwork(toy_policy())
    parameters = network.parameters_by_name()
    optimizer = PolicyOptimizer(parameters, PPOConfig(optimizer=choice))
    for parameter in parameters.values():
        parameter.grad = torch.ones_like(parameter)
    optimizer.step()
    kinds = {}
    for name in optimizer.get_state():
        parameter, _, quantity = name.rpartition("/")
        kinds.setdefault(parameter, set()).add(quantity)
    assert {name for name, kind in kinds.items() if kind == {"momentum_buffer"}} == {
        *MUON_PARAMETERS[choice]
    }
    assert set(kinds) == set(parameters)


def test_muon_multiplies_in_float32_where_the_processor_has_no_bfloat16(monkeypatch):
    """The same update up to the rounding of bfloat16, by the products that are fast there."""
    weights = {}
    for has_bfloat16 in (True, False):
        monkeypatch.setattr(
            optimizer_module, "cpu_has_bfloat16", lambda has=has_bfloat16: has
        )
        parameters = TrainingNetwork(toy_policy()).parameters_by_name()
        optimizer = PolicyOptimizer(parameters, PPOConfig(optimizer="muon"))
        for _ in range(2):
            for parameter in parameters.values():
                parameter.grad = parameter.detach().sin()
            optimizer.step()
        is_float32 = any(
            isinstance(each, Float32Muon) for each in optimizer._optimizers
        )
        assert is_float32 is not has_bfloat16
        weights[has_bfloat16] = parameters["fc.weight"].detach().clone()
    start = TrainingNetwork(toy_policy()).parameters_by_name()["fc.weight"].detach()
    steps = [weights[each] - start for each in (True, False)]
    assert float(steps[0].norm()) == pytest.approx(float(steps[1].norm()), rel=0.02)
    assert float((steps[0] - steps[1]).norm() / steps[0].norm()) < 0.05


def test_a_second_thread_updates_to_the_same_bytes():
    results = []
    for processes in (1, 2):
        parameters = TrainingNetwork(toy_policy()).parameters_by_name()
        config = PPOConfig(optimizer="muon")
        optimizer = PolicyOptimizer(parameters, config, processes)
        for _ in range(2):
            for parameter in parameters.values():
                parameter.grad = parameter.detach().sin()
            optimizer.step()
        state = {name: value.tobytes() for name, value in optimizer.get_state().items()}
        weights = {name: p.detach().numpy().tobytes() for name, p in parameters.items()}
        results.append((state, weights))
    assert results[0] == results[1]


@pytest.mark.parametrize("shape", [(16, 40), (40, 16), (24, 24)])
def test_orthogonalization_keeps_singular_vectors_and_equalizes_singular_values(shape):
    matrix = torch.randn(shape, generator=torch.Generator().manual_seed(1))
    u, s, v = torch.linalg.svd(matrix, full_matrices=False)
    inside = u.T @ orthogonalized(matrix, 3) @ v.T
    values = inside.diagonal()
    assert (inside - values.diag()).abs().max() < 1e-3
    large = s > 0.3 * s.max()
    assert values[large].min() > 0.5
    assert values.max() < 1.3


def test_an_update_of_float32_muon_is_as_large_as_one_of_adam():
    """Root mean square of about .2 times the learning rate, for matrices and kernels."""
    generator = torch.Generator().manual_seed(2)
    parameter = torch.nn.Parameter(torch.zeros(32, 16, 5, 5))
    parameter.grad = torch.randn(parameter.shape, generator=generator)
    Float32Muon([parameter], lr=0.1, iterations=3).step()
    assert float(parameter.detach().square().mean().sqrt()) == pytest.approx(
        0.02, rel=0.3
    )
    assert float((parameter.detach() * parameter.grad).sum()) < 0
