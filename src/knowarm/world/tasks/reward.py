"""Reward of the reaching task: distance, angle, success and reward."""

from math import atan2, degrees, sqrt

import numpy as np

from knowarm.arrays import Floats, Mask
from knowarm.compiling import njit

SUCCESS_REWARD = 100.0
SUCCESS_ANGLE_DEG = 15.0  # Threshold of the angle in the paper
DISTANCE_WEIGHT = 2.0
ANGLE_DIVISOR_DEG = 70.0


@njit(cache=True, error_model="numpy")
def _element(a: Floats, b: Floats, p: int, q: int) -> float:
    """Return the element (p, q) of A'B, of row-major matrices (9,)."""
    return a[p] * b[q] + a[3 + p] * b[3 + q] + a[6 + p] * b[6 + q]


@njit(cache=True, error_model="numpy")
def measure(
    tcp_position: Floats,
    tcp_matrix: Floats,
    grasp_position: Floats,
    grasp_matrix: Floats,
    ignore_roll: bool,
) -> tuple[Floats, Floats]:
    """Measure how far each gripper is from its grasp frame: distance (n,) [m] and angle (n,) [deg].

    Positions are (n, 3) [m], matrices (n, 9), row-major, both world. With R = A'B, the rotation
    from grasp frame to gripper, the angle is the geodesic one: trace R = 1 + 2 cos and
    |R - R'| = 2 sqrt(2) sin (Frobenius norm). With ``ignore_roll`` it is the angle between the two
    z axes. Both are taken from sine and cosine, which is exact near 0 and 180 degrees.
    """
    n = tcp_position.shape[0]
    distance = np.empty(n)
    angle = np.empty(n)
    for i in range(n):
        square = 0.0
        for k in range(3):
            offset = tcp_position[i, k] - grasp_position[i, k]
            square += offset**2
        distance[i] = sqrt(square)
        a = tcp_matrix[i]
        b = grasp_matrix[i]
        if ignore_roll:
            a_z = a[2::3]
            b_z = b[2::3]
            cosine = 0.0
            for k in range(3):
                cosine += a_z[k] * b_z[k]
            square = 0.0
            for p, q in ((1, 2), (2, 0), (0, 1)):  # of the vector product
                product = a_z[p] * b_z[q] - a_z[q] * b_z[p]
                square += product**2
            sine = sqrt(square)
        else:
            trace = 0.0
            for k in range(9):
                trace += a[k] * b[k]
            skew = 0.0
            for p, q in ((0, 1), (1, 2), (2, 0)):
                upper = _element(a, b, p, q)
                lower = _element(a, b, q, p)
                skew += (upper - lower) ** 2
            sine = 0.5 * sqrt(skew)
            cosine = 0.5 * (trace - 1.0)
        angle[i] = degrees(atan2(sine, cosine))
    return distance, angle


def is_success(
    distance: Floats, angle: Floats, success_distance_m: float, success_angle_deg: float
) -> Mask:
    """Return which grippers are within both thresholds, (n,) bool."""
    return (distance < success_distance_m) & (angle < success_angle_deg)


def paper_reward(distance: Floats, angle: Floats, success: Mask) -> Floats:
    """Compute the reward of the paper's table 1, (n,).

    100 on success, otherwise -2 d^2 - a / 70 with d in metres and a in degrees.
    """
    missed = -DISTANCE_WEIGHT * distance**2 - angle / ANGLE_DIVISOR_DEG
    return np.where(success, SUCCESS_REWARD, missed)
