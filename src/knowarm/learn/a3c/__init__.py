"""A3C: workers with one set of parameters, on a fixed schedule or asynchronously.

`fixed_schedule` has all workers in one process, with `gradients` of each from one backward pass;
`trainer` starts and supervises processes, in each of which a `worker` learns on shared tensors;
`messages` are what they exchange, and `update` is what both schedules compute.
"""

from knowarm.learn.a3c.fixed_schedule import FixedScheduleA3CTrainer
from knowarm.learn.a3c.trainer import A3CTrainer

__all__ = ["A3CTrainer", "FixedScheduleA3CTrainer"]
