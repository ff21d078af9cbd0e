"""The config of a policy with knowledge goes in; one as large without knowledge comes out."""

from dataclasses import replace

from knowarm.policy.config import PolicyConfig
from knowarm.policy.policy import Policy


def matched_without_knowledge(config: PolicyConfig) -> PolicyConfig:
    """Return the capacity control: no knowledge, same LSTM size, as many live parameters.

    Without knowledge the LSTM has fewer inputs; the fully connected layer is widened until the
    total number of parameters is as near as one more or less feature allows.
    """
    target = Policy(config).parameter_counts()["total"]

    def candidate(features: int) -> PolicyConfig:
        return replace(config, fusion="none", hidden=config.hidden_size, features=features)

    # The count is linear in the number of features: two points give the line.
    base, more = (Policy(candidate(n)).parameter_counts()["total"] for n in (1, 2))
    return candidate(max(1, round(1 + (target - base) / (more - base))))
