"""Knowledge-graph embeddings: models, training, link prediction and files of fitted vectors."""
