"""Gripper and grasp frames go in as tensors; distance and angle come out."""

import torch
from torch import Tensor


def measure(
    tcp_position: Tensor,
    tcp_matrix: Tensor,
    grasp_position: Tensor,
    grasp_matrix: Tensor,
    ignore_roll: bool,
) -> tuple[Tensor, Tensor]:
    """Measure how far each gripper is from its grasp frame; see ``rewards.measure``.

    No matrix products: those of float32 may be rounded to ten bits on a GPU.

    Args:
        tcp_position: (n, 3) [m], world.
        tcp_matrix: (n, 3, 3), rotation from gripper to world.
        grasp_position: (n, 3) [m], world.
        grasp_matrix: (n, 3, 3), rotation from grasp frame to world.
        ignore_roll: compare approach axes only.

    Returns:
        distance (n,) [m] and angle (n,) [deg], of the arguments' dtype.
    """
    distance = (tcp_position - grasp_position).square().sum(dim=1).sqrt()
    if ignore_roll:
        a, b = tcp_matrix[:, :, 2], grasp_matrix[:, :, 2]
        sine = torch.linalg.cross(a, b).square().sum(dim=1).sqrt()
        cosine = (a * b).sum(dim=1)
    else:
        # R = A'B: trace = 1 + 2 cos, |R - R'| (Frobenius) = 2 sqrt(2) sin
        turn = (tcp_matrix[:, :, :, None] * grasp_matrix[:, :, None, :]).sum(dim=1)
        trace = turn.diagonal(dim1=1, dim2=2).sum(dim=1)
        skew = (turn - turn.transpose(1, 2)).square().sum(dim=(1, 2))
        sine, cosine = (skew / 8).sqrt(), 0.5 * (trace - 1.0)
    return distance, torch.rad2deg(torch.atan2(sine, cosine))
