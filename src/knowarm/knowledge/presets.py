"""The knowledge of each agent that comes with the package, by the agent's name."""

from dataclasses import replace

from knowarm.knowledge.config import KnowledgeConfig

FULL = KnowledgeConfig(detail="full")
"""The paper's: mean of all words of the sentence, an object with each of its colours a slot."""

FULL_PLUS = KnowledgeConfig(
    detail="full",
    relation_words=False,
    pooling="sif",
    centring=True,
    colour_share=0.6,
    slot_norm=1.0,
)
"""Tells every pair of facets apart: see `knowarm knowledge probe`."""

KNOWLEDGE: dict[str, KnowledgeConfig] = {
    "bm": KnowledgeConfig(detail="none"),
    "partial": KnowledgeConfig(detail="partial"),
    "full": FULL,
    "full+": FULL_PLUS,
    "analogy": replace(FULL, source="analogy", relation_words=False),
    "zeros": replace(FULL, source="zeros"),
    "random": replace(FULL, source="random"),
    "shuffled": replace(FULL, source="shuffled"),
    "onehot": replace(FULL, source="onehot"),
    "wrong-object": replace(FULL, source="wrong-object"),
    "learned": replace(FULL, source="learned"),
    "target": replace(FULL, scope="target"),
    "target+": replace(FULL_PLUS, scope="target"),
    "target-onehot": replace(FULL, source="onehot", scope="target"),
}
"""Knowledge by agent: the paper's three, ours, a graph embedding, controls, per-episode ones."""
