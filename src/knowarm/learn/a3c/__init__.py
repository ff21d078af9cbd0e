"""Worker processes on shared parameters: `trainer` starts and watches, `worker` learns.

`shared` is the memory they share, `rmsprop` how they change it, `messages` what they say.
"""

from knowarm.learn.a3c.trainer import A3CTrainer

__all__ = ["A3CTrainer"]
