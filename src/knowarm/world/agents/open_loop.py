"""Search for the best fixed list of actions of a task, which an open-loop agent plays.

Its success is the part of a task that needs no observation: a trained agent has to exceed it
before its score says anything about vision.
"""

from collections import Counter, deque
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import chain, product, repeat
from math import ceil, log2

import numpy as np

from knowarm.arrays import Floats, Integers, Mask
from knowarm.world.agents.open_loop_score import OpenLoopScore
from knowarm.world.agents.play import play
from knowarm.world.agents.scripted import OracleAgent
from knowarm.world.cache import cache_file, read_arrays, write_arrays
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.scene import build_scene
from knowarm.world.tasks.sampling import Episodes, derive
from knowarm.world.tasks.skills.ik import IKSolution, InverseKinematics
from knowarm.world.tasks.state import ACTION_LEVELS

BUDGET = 20_000  # Candidates that a search scores: 13 s on one core with three targets
SEARCH_EPISODES = 1_000  # Episodes on which candidates are scored
ANCHORS = (-0.6, 0.0, 0.6)
"""Places of the anchor targets along each side of the rectangle, in units of its half size."""

# Beginnings of tours kept for each number of steps and set of targets solved

BEAM_WIDTH = 2
VISITED_SHARE = 0.08
"""Share of a target's episodes that must be solved for the target to count as visited."""

MOST_GROUPS = 32
"""More targets than this are grouped with their neighbours; each group counts as one target."""

MEMORY = 40
"""Late acceptance: a mutation is kept if it is no worse than the list this many mutations ago."""

LEVEL_ODDS = np.array([0.25, 0.3, 0.3, 0.05, 0.05, 0.025, 0.025])
"""How often a mutation draws each action: rarely the small ones, which hardly move the arm."""

REPLAYED_LISTS = 12  # Lists that are replayed where contacts matter
REPLAYED_EPISODES = 48  # Episodes in which each of them is played

# Part of the cache's key; to be increased with every change of the results

REVISION = 1
Actions = Integers  # A list of actions: indices into ``ACTION_LEVELS``, (T, J)


@lru_cache(maxsize=16)
def search_open_loop(config: EnvConfig, budget: int = BUDGET, seed: int = 0) -> Actions:
    """Search for the fixed list of actions, (T, J), that solves most episodes of a task.

    The list is kept in the user's cache, where the next search of the same task finds it, unless
    contacts matter.

    A third of the budget builds tours through joint angles that grasp the targets at anchor places:
    a beam search over the number of steps, which keeps the best tours for each set of targets that
    they solve. The rest improves the best tour of each set by hill climbing; after each round the
    better half goes on. Candidates, whole lists or segments of a tour, are scored with exact joint
    angles (``dynamics="kinematic"``).

    In a task without kinematic dynamics, where contacts matter, the candidates are the lists by
    which the oracle solves ``REPLAYED_LISTS`` episodes, played in ``REPLAYED_EPISODES``.
    """
    is_kinematic = "kinematic" in config.task.skill.dynamics
    count = REPLAYED_EPISODES
    if is_kinematic:
        count = SEARCH_EPISODES
    # No evaluation of any seed has these episodes.
    episodes = evaluation_episodes(config, count, seed, "open-loop episodes")
    if not is_kinematic:
        return _best_replayed(config, episodes)
    score = OpenLoopScore(config, episodes)
    goal = _anchor_goals(score)
    file = cache_file("open-loop", REVISION, budget, seed, goal, *score.depends_on())
    stored = read_arrays(file)
    if stored is not None:
        return stored["actions"].astype(np.int64)
    waypoints = _waypoints(score, goal, seed)
    actions = _search(score, waypoints, budget, seed)
    write_arrays(file, {"actions": actions})
    return actions


def _best_replayed(config: EnvConfig, episodes: Episodes) -> Actions:
    """Return the list of the oracle's actions in one episode that solves most of all of them."""
    env = ArmVectorEnv(config, len(episodes))
    steps = play(OracleAgent(env), env, episodes[:REPLAYED_LISTS]).steps
    not_drawn = np.zeros(len(episodes), bool)

    def count_solved(actions: Actions) -> int:
        env.reset(options={"episodes": episodes})
        is_solved = np.zeros_like(not_drawn)
        for action in actions:
            same = np.tile(action, (len(episodes), 1))
            _, _, terminated, _, infos = env.advance(same, not_drawn)
            is_solved |= terminated & infos["is_success"]
        return int(is_solved.sum())

    lists = [steps.actions[steps.episode == i] for i in range(REPLAYED_LISTS)]
    best = max(lists, key=count_solved)
    missing = config.max_episode_steps - len(best)
    return np.pad(best, ((0, missing), (0, 0)))


def _search(score: OpenLoopScore, waypoints: Floats, budget: int, seed: int) -> Actions:
    """Build tours through the waypoints and improve them; see `search_open_loop`."""
    generator = np.random.default_rng(derive(seed, "open-loop mutations"))
    tours, spent = _search_tours(score, waypoints, budget // 3)
    climbs = list(map(partial(_Climb, score), tours))
    rounds = max(1, ceil(log2(len(climbs))))
    for left in range(rounds, 0, -1):
        share = (budget - spent) // left
        for climb in climbs:
            climb.run(share // len(climbs), generator)
        spent += share
        climbs.sort(key=lambda climb: -climb.best_solved)
        climbs = climbs[: (len(climbs) + 1) // 2]
    return climbs[0].best


def _anchor_goals(score: OpenLoopScore) -> Floats:
    """Grasp frames of one target per group at each anchor as transforms to world, (G A, 3, 4)."""
    robot = score.scene.robot
    grid = np.stack(np.meshgrid(ANCHORS, ANCHORS), axis=-1).reshape(-1, 2)
    places = robot.rectangle_centre_m + grid * robot.rectangle_half_size_m
    _, first = np.unique(_group_of(score), return_index=True)
    targets = np.repeat(first, len(places))
    return score.goals(targets, np.tile(places, (len(first), 1)))


def _group_of(score: OpenLoopScore) -> Integers:
    """Return the group of each target, (K,): its own, or one with neighbours of many."""
    targets = len(score.scene.targets)
    return np.arange(targets) * min(targets, MOST_GROUPS) // targets


def _waypoints(score: OpenLoopScore, goal: Floats, seed: int) -> Floats:
    """Joint angles (W, J) that grasp each target at each anchor.

    They are the nearest to the mean start, and the nearest to a grasp of each target.
    """
    position = goal[..., 3].copy()
    matrix = goal[..., :3].reshape(-1, 9).copy()
    scene = score.scene
    arm = build_scene(scene.robot, scene.targets[:1])  # each object takes time
    solver = InverseKinematics(arm, seed=seed)

    def solve(start: Floats) -> IKSolution:
        return solver.solve(position, matrix, np.tile(start, (len(goal), 1)))

    near_start = solve(score.start.mean(axis=0))
    anchors = len(ANCHORS) ** 2
    grasps = near_start.joints[anchors // 2 :: anchors]
    reaching = []
    for solution in (near_start, *map(solve, grasps)):
        is_reached = solution.within(0.03, 10.0)
        reaching.append(solution.joints[is_reached])
    rows = np.concatenate(reaching)
    _, first = np.unique(rows.round(1), axis=0, return_index=True)
    return rows[np.sort(first)]


@dataclass(frozen=True)
class _Tour:
    """The beginning of a list of actions."""

    actions: Actions  # (t, J)
    joints: Floats  # Angles of every search episode after them [rad], (E, J)
    solved: Mask  # Which episodes are solved, (E,)
    last: int  # Index of the waypoint it ends at; -1 for none


def _search_tours(
    score: OpenLoopScore,
    waypoints: Floats,
    budget: int,
) -> tuple[list[Actions], int]:
    """Search lists by a beam over the number of steps, extended by straight moves to waypoints.

    Return lists of full length, the best for each set of targets, and the budget spent.
    """
    limit = score.config.max_episode_steps
    beams: list[list[_Tour]] = [[] for _ in range(limit + 1)]
    for tour in _first_moves(score):
        beams[len(tour.actions)].append(tour)
    spent = 0
    for used in range(limit):
        for tour in _best(score, beams[used], BEAM_WIDTH):
            middle = tour.joints.mean(axis=0)
            for w, goal in enumerate(waypoints):
                if spent >= budget:
                    break
                if w == tour.last:
                    continue
                actions = _segment(score, middle, goal, limit - used)
                beams[used + len(actions)].append(_extended(score, tour, actions, w))
                spent += 1
        beams[used] = _best(score, beams[used], 1)
    lists = []
    for tour in _best(score, list(chain.from_iterable(beams)), 1):
        still = _stand_still(score, limit - len(tour.actions))
        lists.append(np.concatenate([tour.actions, still]))
    return lists, spent


def _stand_still(score: OpenLoopScore, steps: int) -> Actions:
    """Return actions without movement, (steps, J)."""
    return np.zeros((steps, score.scene.num_joints), np.int64)


def _extended(score: OpenLoopScore, tour: _Tour, actions: Actions, last: int) -> _Tour:
    """Play more actions (t, J) after a tour, to the waypoint ``last``."""
    solved_at = np.where(tour.solved, -1, 0)
    first, end = score.play(actions, tour.joints, solved_at)
    actions = np.concatenate([tour.actions, actions])
    return _Tour(actions, end, score.is_solved(first), last)


def _segment(score: OpenLoopScore, start: Floats, goal: Floats, steps: int) -> Actions:
    """Move from joint angles to joint angles (J,) in a straight line, in at most so many steps.

    The slowest joint moves by MPI at every step, the others as near to the line as they can.
    """
    way = goal - start
    increments = score.increments
    needed = max(1, ceil(np.abs(way).max() / increments.max() - 0.05))
    actions = _stand_still(score, min(needed, steps))
    joints = start
    for t in range(len(actions)):
        error = start + way * (t + 1) / needed - joints
        misses = np.abs(error[:, None] - increments)
        actions[t] = misses.argmin(axis=1)
        joints = joints + increments[actions[t]]
    return actions


def _first_moves(score: OpenLoopScore) -> list[_Tour]:
    """Begin tours: with nothing, or by moving start joints to a limit, where offsets vanish."""
    scene = score.scene
    start = score.start
    limit = score.config.max_episode_steps
    unsolved = np.zeros(len(start), bool)
    no_moves = _Tour(_stand_still(score, 0), start, unsolved, -1)
    tours = [no_moves]
    # Level 0 stays, level 1 moves to the upper limit, level 2 to the lower one.
    ways = (
        np.zeros(scene.num_joints),
        scene.joint_upper - start.min(axis=0),
        start.max(axis=0) - scene.joint_lower,
    )
    needed = np.ceil(np.stack(ways) / score.increments.max())
    needed = needed.astype(np.int64)
    varied = np.flatnonzero(np.ptp(start, axis=0) > 0)[::-1]
    for levels in product(range(len(ways)), repeat=len(varied)):
        actions = _stand_still(score, limit)
        steps = 0
        for joint, level in zip(varied, levels, strict=True):
            until = needed[level, joint]
            actions[:until, joint] = level
            steps = max(steps, until)
        if 0 < steps <= limit // 2:
            tours.append(_extended(score, no_moves, actions[:steps], -1))
    return tours


def _best(score: OpenLoopScore, tours: list[_Tour], count: int) -> list[_Tour]:
    """Keep, for each set of targets visited, the tours that solve most; best first."""
    kept: list[_Tour] = []
    sizes: Counter[bytes] = Counter()
    seen: set[bytes] = set()
    group = _group_of(score)[score.target]
    episodes = np.bincount(group)
    for tour in sorted(tours, key=lambda tour: -tour.solved.sum()):
        shares = np.bincount(group, tour.solved) / np.maximum(episodes, 1)
        key = (shares > VISITED_SHARE).tobytes()
        fingerprint = tour.solved.tobytes() + tour.joints[0].round(1).tobytes()
        if sizes[key] < count and fingerprint not in seen:
            sizes[key] += 1
            seen.add(fingerprint)
            kept.append(tour)
    return kept


class _Climb:
    """Late-acceptance hill climbing on a list of actions (Burke and Bykov 2017)."""

    def __init__(self, score: OpenLoopScore, actions: Actions) -> None:
        self._score = score
        self._actions = actions
        self._first, _ = score.play(actions)
        self._solved = int(score.is_solved(self._first).sum())
        self.best = actions
        self.best_solved = self._solved
        self._memory = deque(repeat(self._solved, MEMORY), MEMORY)

    def run(self, budget: int, generator: np.random.Generator) -> None:
        """Try so many mutations."""
        for _ in range(budget):
            candidate = _mutate(self._actions, generator)
            is_changed = (candidate != self._actions).any(axis=1)
            changed = np.flatnonzero(is_changed)
            if not len(changed):
                continue
            first, _ = self._score.play(candidate, None, self._first, int(changed[0]))
            solved = int(self._score.is_solved(first).sum())
            if solved >= min(self._solved, self._memory[0]):
                self._actions = candidate
                self._first = first
                self._solved = solved
            self._memory.append(self._solved)
            if solved > self.best_solved:
                self.best = candidate
                self.best_solved = solved


def _mutate(actions: Actions, generator: np.random.Generator) -> Actions:
    """Change one thing: one joint's actions in a window, or the time of an action."""
    actions = actions.copy()
    steps, joints = actions.shape
    moved = [*range(joints)]
    if generator.random() >= 0.3:
        moved = [generator.integers(joints)]
    first, second = generator.integers(steps, size=2)
    if generator.random() < 0.5:  # move an action; what lies between shifts by one step
        others = np.delete(actions[:, moved], first, axis=0)
        actions[:, moved] = np.insert(others, second, actions[first, moved], axis=0)
    else:
        width = 1 + generator.geometric(0.4)
        level = generator.choice(len(ACTION_LEVELS), p=LEVEL_ODDS)
        joint = generator.integers(joints)
        actions[first : first + width, joint] = level
    return actions
