"""Labels and names go in; vectors of `dim` numbers come out: words, graph embeddings, placebos."""
