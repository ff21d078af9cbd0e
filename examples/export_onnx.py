"""Export a trained policy and play it with ONNX Runtime, without PyTorch in the loop.

pip install 'knowarm[onnx]'
python examples/export_onnx.py runs/irb120-full-fast/0 --episodes 20
"""

import argparse
from pathlib import Path

import numpy as np
import onnxruntime

from knowarm.experiment.load import load_agent
from knowarm.policy.onnx_export import export_onnx
from knowarm.world.agents.play import play
from knowarm.world.envs.vector_env import ReachVectorEnv
from knowarm.world.tasks.episodes import evaluation_episodes


class OnnxAgent:
    """Plays an exported policy; an agent like any other of `knowarm.world.agents.play`."""

    def __init__(self, path: Path, knowledge: np.ndarray) -> None:
        self.session = onnxruntime.InferenceSession(path)
        self.knowledge = knowledge
        self.hidden = self.session.get_inputs()[2].shape[1]

    def start(self, env: ReachVectorEnv) -> None:
        self.env = env
        self.h = self.c = np.zeros((env.num_envs, self.hidden), np.float32)
        self.first = np.ones(env.num_envs, bool)

    def act(self, observations: np.ndarray) -> np.ndarray:
        inputs = {
            "image": observations,
            "knowledge": self.knowledge[self.env.knowledge_input],
            "h": self.h,
            "c": self.c,
            "episode_start": self.first,
        }
        actions, _, _, self.h, self.c = self.session.run(None, inputs)
        self.first = np.zeros_like(self.first)
        return actions


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--output", type=Path, default=Path("policy.onnx"))
    arguments = parser.parse_args()

    trained = load_agent(arguments.run)
    export_onnx(trained.policy, arguments.output)
    env = ReachVectorEnv(trained.config.env, arguments.episodes)
    episodes = evaluation_episodes(trained.config.env, arguments.episodes, 0)
    theirs = play(
        OnnxAgent(arguments.output, trained.policy.knowledge_table.numpy()), env, episodes
    )
    ours = play(trained.agent, env, episodes)
    print(f"{arguments.output}: mean return {theirs.episode_return.mean():.2f} with ONNX Runtime,")
    print(f"{ours.episode_return.mean():.2f} with PyTorch, on the same {len(episodes)} episodes")


if __name__ == "__main__":
    main()
