"""Mutations of the package that its tests must notice: data of `tests.mutate`."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutation:
    """A deliberate mistake: one change of one file.

    Attributes:
        name: the mistake in words.
        file: path below ``src/knowarm``.
        before: text that occurs once in the file.
        after: text that replaces it.
        tests: arguments of pytest that select the tests that should fail.
    """

    name: str
    file: str
    before: str
    after: str
    tests: str


NUMBERS = "tests/test_paper_numbers.py"
REFERENCE = "tests/policy/test_reference.py"
COLLECTOR = "tests/learn/test_collector.py"
UPDATE = "tests/learn/test_ppo_update.py"
LOSSES = "tests/learn/test_losses.py"
PRIVILEGED = "tests/learn/test_privileged.py"
RETURNS = "tests/learn/test_returns.py"
VERDICTS = "tests/report/test_verdicts.py"

WORLD = [
    (
        "a second try at the objects",
        "world/tasks/choose.py",
        "reached & (nearest != 0)",
        "reached & (nearest < 0)",
        "tests/world/test_choose.py::test_whoever_reaches_another_object_gets_no_second_try",
    ),
    (
        "reward of success",
        "world/tasks/reward.py",
        "SUCCESS_REWARD = 100.0",
        "SUCCESS_REWARD = 10.0",
        f"{NUMBERS}::test_reward",
    ),
    (
        "weight of the distance",
        "world/tasks/reward.py",
        "DISTANCE_WEIGHT = 2.0",
        "DISTANCE_WEIGHT = 1.0",
        f"{NUMBERS}::test_reward",
    ),
    (
        "weight of the angle",
        "world/tasks/reward.py",
        "ANGLE_DIVISOR_DEG = 70.0",
        "ANGLE_DIVISOR_DEG = 90.0",
        f"{NUMBERS}::test_reward",
    ),
    (
        "success by distance or angle",
        "world/tasks/reward.py",
        "(distance < success_distance_m) & (angle",
        "(distance < success_distance_m) | (angle",
        f"{NUMBERS}::test_success_thresholds",
    ),
    (
        "20 degrees for 17",
        "experiment/config.py",
        "    angle_deg: float = 17.0",
        "    angle_deg: float = 20.0",
        f"{NUMBERS}::test_evaluations",
    ),
    (
        "interim evaluations too rare",
        "experiment/config.py",
        "every_steps: int = 50_000",
        "every_steps: int = 500_000",
        f"{NUMBERS}::test_evaluations",
    ),
    (
        "20 degrees for 15",
        "world/config.py",
        "success_angle_deg: float = 15.0",
        "success_angle_deg: float = 20.0",
        f"{NUMBERS}::test_success_thresholds",
    ),
    (
        "10 cm for 5 cm",
        "world/config.py",
        "success_distance_m: float = 0.05",
        "success_distance_m: float = 0.10",
        f"{NUMBERS}::test_success_thresholds",
    ),
    (
        "episodes of 100 steps",
        "world/config.py",
        "max_episode_steps: int = 50",
        "max_episode_steps: int = 100",
        f"{NUMBERS}::test_the_time_limit_is_50_steps",
    ),
    (
        "time limit one step late",
        "world/tasks/reach.py",
        "(self.steps >= self.config.max_episode_steps)",
        "(self.steps > self.config.max_episode_steps)",
        f"{NUMBERS}::test_the_time_limit_is_50_steps",
    ),
    (
        "size of the increments",
        "world/tasks/reach.py",
        "(0.0, 1.0, -1.0, 0.1, -0.1, 0.01, -0.01)",
        "(0.0, 1.0, -1.0, 0.5, -0.5, 0.01, -0.01)",
        f"{NUMBERS}::test_increments",
    ),
    (
        "rectangle turned by 90 degrees",
        "world/robots/__init__.py",
        "rectangle_half_size_m=(0.10, 0.30)",
        "rectangle_half_size_m=(0.30, 0.10)",
        f"{NUMBERS}::test_episodes_start_where_the_paper_says",
    ),
    (
        "rectangle twice as long",
        "world/robots/__init__.py",
        "rectangle_half_size_m=(0.10, 0.125)",
        "rectangle_half_size_m=(0.10, 0.25)",
        f"{NUMBERS}::test_episodes_start_where_the_paper_says",
    ),
    (
        "start within 30 %",
        "world/robot.py",
        "start_fraction: float = 0.15",
        "start_fraction: float = 0.30",
        f"{NUMBERS}::test_episodes_start_where_the_paper_says",
    ),
    (
        "joint range",
        "world/robots/irb120/irb120.xml",
        'range="-1.91986 1.22173"',
        'range="-1.91986 1.91986"',
        f"{NUMBERS}::test_joint_ranges_and_axes",
    ),
    (
        "mass of a link",
        "world/robots/tiago/tiago.xml",
        'mass="1.433"',
        'mass="1.333"',
        f"{NUMBERS}::test_links",
    ),
    (
        "colour of the purple bottle",
        "world/objects/__init__.py",
        '"purple": (0.4, 0.0, 0.9)',
        '"purple": (0.9, 0.0, 0.4)',
        f"{NUMBERS}::test_colours",
    ),
]

POLICY = [
    (
        "no ReLU after the second convolution",
        "policy/encoder.py",
        "torch.relu(F.conv2d(x, self._block_weight(), self.conv2.bias))",
        "F.conv2d(x, self._block_weight(), self.conv2.bias)",
        REFERENCE,
    ),
    (
        "no ReLU after the fully connected layer",
        "policy/policy.py",
        'return torch.relu(features) if self.config.fc_activation == "relu" else features',
        "return features",
        REFERENCE,
    ),
    (
        "pixels shifted the wrong way",
        "policy/encoder.py",
        "bias = bias - self.pixel_shift",
        "bias = bias + self.pixel_shift",
        REFERENCE,
    ),
    (
        "one bias of the LSTM missing",
        "policy/lstm.py",
        "self.bias_ih + self.bias_hh",
        "self.bias_ih",
        REFERENCE,
    ),
    (
        "memory kept over episodes",
        "policy/lstm.py",
        "keep = (~episode_start).to(self.weight_hh.dtype)[:, :, None]",
        "keep = torch.ones_like(episode_start).to(x.dtype)[:, :, None]",
        REFERENCE,
    ),
    (
        "knowledge of the first facet only",
        "policy/policy.py",
        "else self.knowledge_table[facet]",
        "else self.knowledge_table[facet * 0]",
        REFERENCE,
    ),
    (
        "capacity control with wider vision",
        "policy/policy.py",
        'return replace(config, fusion="none", hidden=hidden)',
        'return replace(config, fusion="none", hidden=hidden, features=202)',
        "tests/policy/test_policy.py -k capacity",
    ),
]

LEARN = [
    (
        "time limit and success swapped",
        "learn/returns.py",
        "final_values: Tensor, terminated: Tensor, truncated: Tensor",
        "final_values: Tensor, truncated: Tensor, terminated: Tensor",
        UPDATE,
    ),
    (
        "episodes end on termination only",
        "learn/rollout.py",
        "return self.terminated | self.truncated",
        "return self.terminated",
        UPDATE,
    ),
    (
        "facet of the next episode",
        "learn/collector.py",
        "            rollout.truncated[t] = truncated\n",
        "            rollout.truncated[t] = truncated\n"
        "            rollout.facet[t] = self.env.facet_ids\n",
        COLLECTOR,
    ),
    (
        "final observation with another facet",
        "learn/collector.py",
        "rollout.facet[t, ids], state, start",
        "0 * rollout.facet[t, ids], state, start",
        COLLECTOR,
    ),
    (
        "a success has a future",
        "learn/returns.py",
        "return torch.where(terminated, torch.zeros_like(following), following)",
        "return following",
        RETURNS,
    ),
    (
        "advantages leak into the episode before",
        "learn/returns.py",
        "gamma * gae_lambda * (~done).to(rewards.dtype)",
        "gamma * gae_lambda * torch.ones_like(rewards)",
        RETURNS,
    ),
    (
        "no lower clip bound",
        "learn/losses.py",
        "ratio.clamp(1 - clip_range, 1 + clip_range)",
        "ratio.clamp(max=1 + clip_range)",
        LOSSES,
    ),
    (
        "entropy punished",
        "learn/losses.py",
        "ent_coef * spread\n    if auxiliary is None",
        "-ent_coef * spread\n    if auxiliary is None",
        LOSSES,
    ),
    (
        "reward not scaled",
        "learn/ppo.py",
        "reward = reward * config.reward_scale",
        "pass",
        UPDATE,
    ),
    (
        "learning-rate schedule not applied",
        "learn/ppo.py",
        "self._optimizer.set_learning_rate(rate)",
        "pass",
        UPDATE,
    ),
    (
        "terminal states valued by the state critic",
        "learn/ppo.py",
        "torch.where(rollout.terminated, 0, following)",
        "following",
        PRIVILEGED,
    ),
    (
        "auxiliary loss ignored",
        "learn/losses.py",
        "total = total + auxiliary_coef * auxiliary",
        "pass",
        PRIVILEGED,
    ),
    (
        "progress rewarded with the opposite sign",
        "learn/privileged.py",
        "gained = self.rollout.state - self.rollout.next_state",
        "gained = self.rollout.next_state - self.rollout.state",
        PRIVILEGED,
    ),
    (
        "advantages not normalized",
        "learn/ppo.py",
        "if config.normalize_advantages:",
        "if False:",
        UPDATE,
    ),
    ("gradient not clipped", "learn/ppo.py", "gradient.mul_(limit / norm)", "pass", UPDATE),
]

EVIDENCE = [
    (
        "placebos of another length",
        "knowledge/embedding.py",
        "matrix = _with_lengths(matrix, real)",
        "pass",
        "tests/knowledge/test_embedding.py -k placebos_copy",
    ),
    (
        "controls of another scope",
        "report/claims.py",
        "if group.scope != subject.scope:",
        "if False:",
        f"{VERDICTS} -k privileged",
    ),
    (
        "controls of another size",
        "report/claims.py",
        "TOLERANCE = 0.01",
        "TOLERANCE = 100.0",
        f"{VERDICTS} -k another_size",
    ),
    (
        "claims from two seeds",
        "report/claims.py",
        "FEWEST_SEEDS = 3",
        "FEWEST_SEEDS = 2",
        f"{VERDICTS} -k few_seeds",
    ),
]

MUTATIONS = tuple(Mutation(*fields) for fields in (*WORLD, *POLICY, *LEARN, *EVIDENCE))
