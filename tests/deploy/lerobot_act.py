"""Train LeRobot's ACT with quantiles on a dataset: python lerobot_act.py FOLDER STEPS.

Runs in an environment with LeRobot, without KnowArm. Prints episodes, shape of an image, and the
loss at start and end.
"""

import sys

import torch
from lerobot.configs.types import NormalizationMode
from lerobot.datasets.lerobot_dataset import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.factory import make_policy, make_pre_post_processors

folder, steps = sys.argv[1], int(sys.argv[2])
torch.manual_seed(0)
torch.set_num_threads(1)
about = LeRobotDatasetMetadata("local/knowarm", root=folder)
quantiles = dict.fromkeys(("STATE", "ACTION"), NormalizationMode.QUANTILES)
sizes = {"chunk_size": 8, "n_action_steps": 8, "dim_model": 64, "n_heads": 2}
config = ACTConfig(
    **sizes,
    device="cpu",
    push_to_hub=False,
    pretrained_backbone_weights=None,
    use_vae=False,
    normalization_mapping={"VISUAL": NormalizationMode.MEAN_STD, **quantiles},
)
policy = make_policy(config, ds_meta=about)
preprocess, _ = make_pre_post_processors(config, dataset_stats=about.stats)
times = {"action": [i / about.fps for i in range(config.chunk_size)]}
data = LeRobotDataset("local/knowarm", root=folder, delta_timestamps=times)
sampler = torch.utils.data.RandomSampler(data, replacement=True, num_samples=8 * steps)
optimizer, losses = torch.optim.AdamW(policy.parameters(), lr=3e-4), []
for batch in torch.utils.data.DataLoader(data, 8, sampler=sampler):
    loss, _ = policy.forward(preprocess(batch))
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    losses.append(loss.item())
shape = "x".join(map(str, data[0]["observation.images.front"].shape))
print(data.num_episodes, shape, sum(losses[:10]) / 10, sum(losses[-10:]) / 10)
