"""Two small vector environments of images: copy what is seen, recall what was seen."""

import numpy as np

JOINTS, LEVELS, SIDE = 2, 3, 20


class ToyEnv:
    """Each joint must choose the level its half of the image shows, as a shade of grey.

    Identity (``recall=False``): a new image and a reward every step, cut after ``length``.
    Memory (``recall=True``): the image is black after the first step and only the last action
    is rewarded; the episode then terminates.
    """

    def __init__(self, num_envs: int, *, recall: bool, length: int) -> None:
        self.num_envs, self.recall, self.length = num_envs, recall, length
        self.facet_ids = np.zeros(num_envs, np.int64)

    def reset(self, *, seed=None, options=None):
        self._seed = seed
        self._clock = np.zeros(self.num_envs, np.int64)
        self._draws = np.zeros((), np.int64)
        self._cue = self._draw()
        return self._look(), {}

    def step(self, actions):
        right = (actions == self._cue).mean(1)
        self._clock += 1
        done = self._clock == self.length
        if not self.recall:
            self._cue = self._draw()
        before = self._look()
        if self.recall:
            reward = np.where(done, right, 0.0)
            self._cue = np.where(done[:, None], self._draw(), self._cue)
        else:
            reward = right
        self._clock[done] = 0
        none = np.zeros_like(done)
        success = right == 1
        infos = {"final_obs": before, "final_info": {"is_success": success}}
        terminated, truncated = (done, none) if self.recall else (none, done)
        return self._look(), reward, terminated, truncated, infos

    def get_state(self):
        return {
            "clock": self._clock.copy(),
            "cue": self._cue.copy(),
            "draws": np.array(self._draws),
            "seed": np.array(self._seed),
        }

    def set_state(self, state):
        self._clock, self._cue = state["clock"].copy(), state["cue"].copy()
        self._draws, self._seed = np.array(state["draws"]), int(state["seed"])

    def close(self):
        pass

    def _draw(self):
        self._draws = self._draws + 1
        random = np.random.default_rng((self._seed, int(self._draws)))
        return random.integers(0, LEVELS, (self.num_envs, JOINTS))

    def _look(self):
        image = np.zeros((self.num_envs, SIDE, SIDE, 3), np.uint8)
        if self.recall:
            shade = np.where(self._clock[:, None] == 0, 60 + 90 * self._cue, 0)
        else:
            shade = 60 + 90 * self._cue
        half = SIDE // 2
        image[:, :, :half] = shade[:, 0, None, None, None]
        image[:, :, half:] = shade[:, 1, None, None, None]
        return image
