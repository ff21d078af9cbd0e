"""Trainer of agents that act without a policy: it saves the initial weights and ends."""

from knowarm.learn.checkpoint import Checkpoint, policy_arrays
from knowarm.learn.trainer import StopReason, Trainer


class UntrainedTrainer(Trainer):
    """Trains nothing; see `knowarm.learn.Trainer`."""

    def _train(self, total_steps: int) -> StopReason:
        self.step = total_steps
        if self.checkpoints is not None:
            facts = {"step": self.step}
            checkpoint = Checkpoint(policy=policy_arrays(self.policy), facts=facts)
            self.checkpoints.save_best(checkpoint)
            self._save(checkpoint)
        return "finished"

    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore nothing more."""
