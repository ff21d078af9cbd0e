"""Learning algorithms: recurrent PPO and A3C on torch vector environments.

A trainer (`ppo`, `a3c`, both on `trainer`) steps a vector environment (`environment`) with a
`collector` that fills a `rollout`; `losses` define what is learned from it. PPO's
`learner` computes in one process or in several. `evaluation` runs interim evaluations, `guards`
stop at non-finite values, `checkpoint` saves and resumes.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
