import pytest
import torch

from knowarm.errors import UserError
from knowarm.knowledge.kge import KgeConfig
from knowarm.knowledge.kge.models import MODELS
from knowarm.knowledge.kge.train import new_model
from knowarm.knowledge.vectors import source_named
from knowarm.knowledge.vectors.graph_embedding import GraphEmbedding

DIM = 10


def model_with(name, entity, relation):
    model = new_model(KgeConfig(model=name, dim=len(entity[0])), len(entity), 1)
    with torch.no_grad():
        model.entity.copy_(torch.tensor(entity))
        model.relation[0].copy_(torch.tensor(relation))
    return model


def score(model, head=0, tail=1):
    return model(torch.tensor([head]), torch.tensor([0]))[0, tail].item()


def test_scores_by_hand():
    h, t = [1.0, 2.0, 3.0, 4.0], [2.0, 0.0, 1.0, -1.0]
    # complex numbers 1+3i, 2+4i; relation i, 1; tail 2+1i, 0-1i
    value = ((1 + 3j) * 1j * (2 - 1j) + (2 + 4j) * 1 * (0 + 1j)).real
    assert score(model_with("complex", [h, t], [0.0, 1.0, 1.0, 0.0])) == pytest.approx(
        value
    )
    # two scalars, then one complex pair 3+4i, relation 2+1i, tail 1-1i
    value = 1 * 3 * 2 + 2 * 1 * 0 + ((3 + 4j) * (2 + 1j) * (1 + 1j)).real
    assert score(model_with("analogy", [h, t], [3.0, 1.0, 2.0, 1.0])) == pytest.approx(
        value
    )


@pytest.mark.parametrize("name", MODELS)
def test_gradients_are_finite_even_where_vectors_are_equal(name):
    model = new_model(KgeConfig(model=name, dim=DIM), 3, 1)
    with torch.no_grad():
        model.entity.zero_()
        model.relation.zero_()
    ids = torch.tensor([0]), torch.tensor([0])
    loss = torch.nn.functional.cross_entropy(model(*ids), torch.tensor([1]))
    (loss + model.penalty(*ids, torch.tensor([1]))).backward()
    for parameter in model.parameters():
        assert torch.isfinite(parameter.grad).all()


def test_n3_by_hand():
    model = model_with(
        "complex", [[3.0, 0.0, 4.0, 0.0], [0.0, 0.0, 1.0, 0.0]], [1.0, 0.0, 0.0, 0.0]
    )
    # moduli: |3+4i| = 5 of the head, |1| = 1 of the relation, |i| = 1 of the tail
    penalty = model.penalty(torch.tensor([0]), torch.tensor([0]), torch.tensor([1]))
    assert penalty.item() == pytest.approx(125 + 1 + 1, rel=1e-4)


def test_the_names_are_known_to_the_embedding():
    for name in MODELS:
        assert source_named(name) == GraphEmbedding(model=name)


def test_bad_configs():
    with pytest.raises(UserError, match=r"model 'analog'.*'analogy'"):
        new_model(KgeConfig(model="analog"), 3, 1)
    with pytest.raises(
        UserError, match="complex got dim=5; it must be at least 4 and even"
    ):
        new_model(KgeConfig(model="complex", dim=5), 3, 1)
    with pytest.raises(UserError, match="dim=2; it must be at least 4"):
        new_model(KgeConfig(model="analogy", dim=2), 3, 1)
