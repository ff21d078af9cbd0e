"""Learning algorithms: recurrent PPO, imitation and A3C on torch vector environments.

A trainer (`ppo`, `distil`, `a3c`, all on `trainer`) steps a vector environment (`environment`) with
the collector of `rollout`, and `losses` define what is learned from a rollout. The `learner` of PPO
and imitation computes in one process or in several; `privileged` holds what they use of the
simulator's state. `evaluation` runs interim evaluations, `guards`
stop at non-finite values, `checkpoint` saves and resumes.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
