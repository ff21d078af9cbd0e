"""Knowledge-graph embeddings: models, training, completion of graphs, files of vectors."""

from dataclasses import dataclass

from knowarm.config import check_values


@dataclass(frozen=True, kw_only=True)
class KgeConfig:
    """1-vs-all training with reciprocal relations (Lacroix, Usunier and Obozinski 2018)."""

    model: str = "analogy"
    """Name of the model: analogy, complex."""
    dim: int = 50
    """Numbers per entity."""
    epochs: int = 400
    """Largest number of passes over the training triples."""
    batch_size: int = 128
    """Queries (h, r, ?) per gradient step, each with all its answers."""
    negatives: int | None = None
    """Compare the queries of a step with so many entities, drawn at random, and their answers; None
    compares them with all, which takes long on graphs of many thousand entities."""
    learning_rate: float | None = None
    """Adam's step size; None takes the model's own."""
    n3: float | None = None
    """Weight of the N3 penalty; None takes the model's own."""
    evaluate_every: int = 10
    """Epochs between two evaluations on the validation triples."""
    patience: int = 8
    """Evaluations without a better MRR after which training stops."""
    seed: int = 0
    """Seed of the initial vectors and the order of triples."""
    threads: int = 1
    """CPU threads; with one, the same seed gives the same bytes on the same machine."""

    def __post_init__(self) -> None:
        check_values(self)
