"""The graph-embedding models, by name."""

from knowarm.knowledge.kge.analogy import Analogy
from knowarm.knowledge.kge.complex import ComplEx
from knowarm.knowledge.kge.distmult import DistMult
from knowarm.knowledge.kge.model import KgeModel
from knowarm.knowledge.kge.rotate import RotatE
from knowarm.knowledge.kge.transe import TransE

MODELS: dict[str, type[KgeModel]] = {
    "analogy": Analogy,
    "transe": TransE,
    "distmult": DistMult,
    "complex": ComplEx,
    "rotate": RotatE,
}
"""A new model is one file like distmult.py and one line here."""
