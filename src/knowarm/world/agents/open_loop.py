"""Search for the best fixed list of actions of a task, which an open-loop agent plays.

Its success is the part of a task that needs no observation: a trained agent has to exceed it
before its score says anything about vision.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from knowarm.world.agents.open_loop_score import OpenLoopScore
from knowarm.world.agents.play import play
from knowarm.world.agents.scripted import OracleAgent
from knowarm.world.cache import cache_file, read_arrays, write_arrays
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.scene import build_scene
from knowarm.world.tasks.sampling import Episodes, derive
from knowarm.world.tasks.skills.ik import InverseKinematics
from knowarm.world.tasks.state import ACTION_LEVELS

BUDGET = 20_000  # Candidates that a search scores: 13 s on one core with three targets
SEARCH_EPISODES = 1_000  # Episodes on which candidates are scored
ANCHORS = (-0.6, 0.0, 0.6)
"""Places of the anchor targets along each side of the rectangle, in units of its half size."""

BEAM_WIDTH = 2  # Beginnings of tours kept for each number of steps and set of targets solved
VISITED_SHARE = 0.08
"""Share of a target's episodes that must be solved for the target to count as visited."""

MOST_GROUPS = 32
"""More targets than this are grouped with their neighbours; each group counts as one target."""

MEMORY = 40
"""Late acceptance: a mutation is kept if it is no worse than the list this many mutations ago."""

LEVEL_ODDS = np.array([0.25, 0.3, 0.3, 0.05, 0.05, 0.025, 0.025])
"""How often a mutation draws each action: rarely the small ones, which hardly move the arm."""

REPLAYED_LISTS, REPLAYED_EPISODES = 12, 48
"""Lists that are replayed where contacts matter, and episodes in which each is played."""

REVISION = 1  # Part of the cache's key; to be increased with every change of the results
Actions = NDArray[np.int64]  # A list of actions: indices into ``ACTION_LEVELS``, (T, J)


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
    others = seed, "open-loop episodes"  # that no evaluation of any seed has
    if "kinematic" not in config.task.dynamics:
        return _best_replayed(config, evaluation_episodes(config, REPLAYED_EPISODES, *others))
    score = OpenLoopScore(config, evaluation_episodes(config, SEARCH_EPISODES, *others))
    goal = _anchor_goals(score)
    file = cache_file("open-loop", REVISION, budget, seed, goal, *score.depends_on())
    if (stored := read_arrays(file)) is not None:
        return stored["actions"].astype(np.int64)
    found = _search(score, _waypoints(score, goal, seed), budget, seed)
    write_arrays(file, {"actions": found})
    return found


def _best_replayed(config: EnvConfig, episodes: Episodes) -> Actions:
    """Return the list of the oracle's actions in one episode that solves most of all of them."""
    env = ArmVectorEnv(config, len(episodes))
    steps = play(OracleAgent(env), env, episodes[:REPLAYED_LISTS]).steps
    best, most = np.zeros((config.max_episode_steps, env.scene.num_joints), dtype=np.int64), -1
    for i in range(REPLAYED_LISTS):
        played = steps.actions[steps.episode == i]
        actions = np.zeros_like(best)
        actions[: len(played)] = played
        env.reset(options={"episodes": episodes})
        solved, unseen = (np.zeros(len(episodes), dtype=np.bool_) for _ in range(2))
        for each in actions[: len(played)]:
            _, _, terminated, _, infos = env.advance(np.tile(each, (len(solved), 1)), unseen)
            solved |= terminated & infos["is_success"]
        if solved.sum() > most:
            best, most = actions, int(solved.sum())
    return best


def _search(
    score: OpenLoopScore, waypoints: NDArray[np.float64], budget: int, seed: int
) -> Actions:
    """Build tours through the waypoints and improve them; see `search_open_loop`."""
    generator = np.random.default_rng(derive(seed, "open-loop mutations"))
    tours, spent = _search_tours(score, waypoints, budget // 3)
    climbs = [_Climb(score, tour) for tour in tours]
    rounds = max(1, math.ceil(math.log2(len(climbs))))
    for left in range(rounds, 0, -1):
        share = (budget - spent) // left
        for climb in climbs:
            climb.run(share // len(climbs), generator)
        spent += share
        climbs.sort(key=lambda climb: -climb.best_solved)
        climbs = climbs[: (len(climbs) + 1) // 2]
    return climbs[0].best


def _anchor_goals(score: OpenLoopScore) -> NDArray[np.float64]:
    """Grasp frames of one target per group at each anchor as transforms to world, (G A, 3, 4)."""
    robot = score.scene.robot
    grid = np.stack(np.meshgrid(ANCHORS, ANCHORS), axis=-1).reshape(-1, 2)
    places = np.array(robot.rectangle_centre_m) + grid * np.array(robot.rectangle_half_size_m)
    first = np.unique(_group_of(score), return_index=True)[1]
    return score.goals(np.repeat(first, len(places)), np.tile(places, (len(first), 1)))


def _group_of(score: OpenLoopScore) -> NDArray[np.int64]:
    """Return the group of each target, (K,): its own, or one with neighbours of many."""
    targets = len(score.scene.targets)
    return np.arange(targets) * min(targets, MOST_GROUPS) // targets


def _waypoints(score: OpenLoopScore, goal: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    """Joint angles (W, J) that grasp each target at each anchor.

    They are the nearest to the mean start, and the nearest to a grasp of each target.
    """
    position, matrix = goal[..., 3].copy(), goal[..., :3].reshape(-1, 9).copy()
    arm = build_scene(score.scene.robot, score.scene.targets[:1])  # each object takes time
    solver = InverseKinematics(arm, seed=seed)
    middle = score.start.mean(axis=0)
    near_start = solver.solve(position, matrix, np.tile(middle, (len(goal), 1)))
    anchors = len(ANCHORS) ** 2
    grasps = near_start.joints[anchors // 2 :: anchors]
    near_grasps = [solver.solve(position, matrix, np.tile(g, (len(goal), 1))) for g in grasps]
    found = (near_start, *near_grasps)
    rows = np.concatenate([each.joints[each.within(0.03, 10.0)] for each in found])
    _, first = np.unique(np.round(rows, 1), axis=0, return_index=True)
    return rows[np.sort(first)]


@dataclass(frozen=True)
class _Tour:
    """The beginning of a list of actions."""

    actions: Actions  # (t, J)
    joints: NDArray[np.float64]  # Angles of every search episode after them [rad], (E, J)
    solved: NDArray[np.bool_]  # Which episodes are solved, (E,)
    last: int  # Index of the waypoint it ends at; -1 for none


def _search_tours(
    score: OpenLoopScore, waypoints: NDArray[np.float64], budget: int
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
                if w == tour.last or spent >= budget:
                    continue
                actions = _segment(score, middle, goal, limit - used)
                beams[used + len(actions)].append(_extended(score, tour, actions, w))
                spent += 1
        beams[used] = _best(score, beams[used], 1)
    lists = []
    for tour in _best(score, [tour for beam in beams for tour in beam], 1):
        rest = np.zeros((limit - len(tour.actions), score.scene.num_joints), dtype=np.int64)
        lists.append(np.concatenate([tour.actions, rest]))
    return lists, spent


def _extended(score: OpenLoopScore, tour: _Tour, actions: Actions, last: int) -> _Tour:
    """Play more actions (t, J) after a tour, to the waypoint ``last``."""
    first, end = score.play(actions, tour.joints, np.where(tour.solved, -1, 0))
    return _Tour(np.concatenate([tour.actions, actions]), end, score.is_solved(first), last)


def _segment(
    score: OpenLoopScore, start: NDArray[np.float64], goal: NDArray[np.float64], steps: int
) -> Actions:
    """Move from joint angles to joint angles (J,) in a straight line, in at most so many steps.

    The slowest joint moves by MPI at every step, the others as near to the line as they can.
    """
    way = goal - start
    needed = max(1, math.ceil(np.abs(way).max() / score.increments.max() - 0.05))
    actions = np.zeros((min(needed, steps), len(way)), dtype=np.int64)
    now = start.copy()
    for t in range(len(actions)):
        line = start + way * (t + 1) / needed
        actions[t] = np.abs((line - now)[:, None] - score.increments).argmin(axis=1)
        now = now + score.increments[actions[t]]
    return actions


def _first_moves(score: OpenLoopScore) -> list[_Tour]:
    """Begin tours: with nothing, or by moving start joints to a limit, where offsets vanish."""
    scene, start = score.scene, score.start
    limit = score.config.max_episode_steps
    unsolved = np.zeros(len(start), dtype=np.bool_)
    tours = [_Tour(np.zeros((0, scene.num_joints), dtype=np.int64), start, unsolved, -1)]
    varied = np.flatnonzero(np.ptp(start, axis=0) > 0)
    for mask in range(1, 3 ** len(varied)):
        actions = np.zeros((limit, scene.num_joints), dtype=np.int64)
        steps = 0
        for i, j in enumerate(varied):
            side = mask // 3**i % 3  # 0: stay, 1: to the upper limit, 2: to the lower
            ways = (0, scene.joint_upper[j] - start[:, j].min(), start[:, j].max())
            far = ways[side] - (scene.joint_lower[j] if side == 2 else 0)
            needed = math.ceil(far / score.increments.max())
            actions[:needed, j] = side
            steps = max(steps, needed)
        if 0 < steps <= limit // 2:
            tours.append(_extended(score, tours[0], actions[:steps], -1))
    return tours


def _best(score: OpenLoopScore, tours: list[_Tour], count: int) -> list[_Tour]:
    """Keep, for each set of targets visited, the tours that solve most; best first."""
    kept: list[_Tour] = []
    sizes: dict[bytes, int] = {}
    seen: set[bytes] = set()
    group = _group_of(score)[score.target]
    episodes = np.bincount(group)
    for tour in sorted(tours, key=lambda tour: -int(tour.solved.sum())):
        shares = np.bincount(group, tour.solved, len(episodes)) / np.maximum(episodes, 1)
        key = (shares > VISITED_SHARE).tobytes()
        same = tour.solved.tobytes() + tour.joints[0].round(1).tobytes()
        if sizes.get(key, 0) < count and same not in seen:
            sizes[key] = sizes.get(key, 0) + 1
            seen.add(same)
            kept.append(tour)
    return kept


class _Climb:
    """Late-acceptance hill climbing on a list of actions (Burke and Bykov 2017)."""

    def __init__(self, score: OpenLoopScore, actions: Actions) -> None:
        self._score = score
        self._actions = self.best = actions
        self._first = score.play(actions)[0]
        self._solved = self.best_solved = int(score.is_solved(self._first).sum())
        self._memory = [self._solved] * MEMORY
        self._trials = 0

    def run(self, budget: int, generator: np.random.Generator) -> None:
        """Try so many mutations."""
        for _ in range(budget):
            candidate = _mutate(self._actions, generator)
            differs = np.flatnonzero((candidate != self._actions).any(axis=1))
            if not len(differs):
                continue
            first, _ = self._score.play(candidate, None, self._first, int(differs[0]))
            solved = int(self._score.is_solved(first).sum())
            place = self._trials % MEMORY
            if solved >= min(self._solved, self._memory[place]):
                self._actions, self._first, self._solved = candidate, first, solved
            self._memory[place] = self._solved
            self._trials += 1
            if solved > self.best_solved:
                self.best, self.best_solved = candidate, solved


def _mutate(actions: Actions, generator: np.random.Generator) -> Actions:
    """Change one thing: one joint's actions in a window, or the time of an action."""
    actions = actions.copy()
    steps, joints = actions.shape
    joint = slice(None) if generator.random() < 0.3 else [generator.integers(joints)]
    first, second = generator.integers(steps, size=2)
    if generator.random() < 0.5:  # move an action in time; what lies between shifts by one
        moved = np.delete(actions[:, joint], first, axis=0)
        actions[:, joint] = np.insert(moved, second, actions[first, joint], axis=0)
    else:
        width = 1 + generator.geometric(0.4)
        level = generator.choice(len(ACTION_LEVELS), p=LEVEL_ODDS)
        actions[first : first + width, generator.integers(joints)] = level
    return actions
