"""Child processes of the learner: workers, shared tensors and supervision."""
