import math

import pytest
import torch

from knowarm.learn.a3c.messages import shared_state_specs
from knowarm.learn.a3c.update import rmsprop_update
from knowarm.learn.parallel.processes import process_context
from knowarm.learn.parallel.shared_tensors import (
    FlatParameters,
    SharedTensors,
    clip_gradient,
    flatten_parameters,
    unflatten_parameters,
)

NUMBERS = {"learning_rate": 0.1, "eps": 0.01}


def test_one_step_by_hand():
    values, mean_square = torch.tensor([1.0]), torch.tensor([4.0])
    rmsprop_update(values, mean_square, torch.tensor([3.0]), **NUMBERS)
    assert mean_square.item() == pytest.approx(0.99 * 4 + 0.01 * 9)
    assert values.item() == pytest.approx(1 - 0.1 * 3 / (math.sqrt(4.05) + 0.01))


def test_it_is_pytorchs_rmsprop():
    torch.manual_seed(0)
    parameter = torch.nn.Parameter(torch.randn(5))
    values, mean_square = parameter.detach().clone(), torch.zeros(5)
    reference = torch.optim.RMSprop([parameter], lr=0.1, alpha=0.99, eps=0.01)
    for _ in range(3):
        gradient = torch.randn(5)
        parameter.grad = gradient.clone()
        reference.step()
        rmsprop_update(values, mean_square, gradient, **NUMBERS)
    torch.testing.assert_close(values, parameter.detach())


def test_flat_vectors_are_the_modules_own():
    layer = torch.nn.Linear(2, 3)
    before = layer.weight.detach().clone()
    flat = FlatParameters(layer)
    assert torch.equal(layer.weight, before)
    flat.values.fill_(2.0)
    assert (layer.weight == 2).all()
    layer(torch.ones(1, 2)).sum().backward()
    assert flat.gradient.tolist() == [1.0] * 9
    assert clip_gradient(flat.gradient, 1.0).item() == pytest.approx(3.0)
    assert torch.linalg.vector_norm(flat.gradient).item() == pytest.approx(1.0)
    assert layer.bias.grad.tolist() == pytest.approx([1 / 3] * 3)


def test_flattening_and_back():
    layer = torch.nn.Linear(2, 3)
    arrays = unflatten_parameters(layer, flatten_parameters(layer))
    assert list(arrays) == ["weight", "bias"]
    for name, parameter in layer.named_parameters():
        assert arrays[name].tobytes() == parameter.detach().numpy().tobytes()


def write(shared, index):
    shared["values"][index] = 10.0 + index
    shared["steps"][index] += 1


def test_processes_see_one_anothers_writes():
    context = process_context()
    shared = SharedTensors(context, shared_state_specs(4, 2))
    children = [
        context.Process(target=write, args=(shared, index)) for index in range(2)
    ]
    for child in children:
        child.start()
    for child in children:
        child.join()
    assert shared["values"].tolist() == [10.0, 11.0, 0.0, 0.0]
    assert shared["steps"].tolist() == [1, 1]
