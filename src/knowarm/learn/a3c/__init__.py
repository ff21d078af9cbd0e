"""A3C: worker processes that update shared parameters asynchronously.

`trainer` starts and supervises the processes; each `worker` learns on shared tensors;
`messages` are what they exchange.
"""

from knowarm.learn.a3c.trainer import A3CTrainer

__all__ = ["A3CTrainer"]
