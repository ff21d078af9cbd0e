"""Choice among several objects: where they stand, and which one the gripper went to.

An episode ends where any of them is reached. Otherwise an agent that does not know which one is
meant would try one after the other.
"""

from typing import TYPE_CHECKING

from knowarm.errors import UserError
from knowarm.world.arrays import Array, Selection, array_namespace
from knowarm.world.episodes import Episodes
from knowarm.world.scene import target_places
from knowarm.world.tasks.reward import is_success, measure

if TYPE_CHECKING:
    from knowarm.world.tasks.reach import ReachTask


def choice_metrics(task: "ReachTask") -> dict[str, Array]:
    """Return the infos that only episodes with several objects have.

    Returns:
        ``chosen``, the target whose grasp point is nearest to the gripper, (n,) int64;
        ``is_choice_correct``, whether it is the wanted one, (n,) bool; ``query``, (n,) int64;
        ``objects`` and ``object_colours``, indices of the visible targets and of their colours
        with the wanted one first, (n, m) int64; ``object_positions``, their x and y, (n, m, 2) [m].
    """
    xp = array_namespace(task.position)
    nearest, _ = _nearest_object(task)
    objects = task.objects
    rows = xp.arange(objects.shape[0], device=objects.device)
    return {
        "chosen": objects[rows, nearest],
        "is_choice_correct": nearest == 0,
        "query": task.query,
        "objects": objects,
        "object_colours": xp.concat([task.colour[:, None], task.other_colour], axis=1),
        "object_positions": _positions(task),
    }


def is_mistaken(task: "ReachTask") -> Array:
    """Return whether the gripper has reached an object that is not the wanted one, (n,) bool.

    That is so where ``chosen`` is another one and its grasp frame is within the thresholds of the
    config, whatever `ReachTask.threshold_factor`.
    """
    config, simulator = task.config, task.simulator
    xp = array_namespace(task.position)
    nearest, position = _nearest_object(task)
    rows = xp.arange(nearest.shape[0], device=nearest.device)
    distance, angle = measure(
        simulator.tcp_position,
        simulator.tcp_matrix,
        xp.astype(position, simulator.tcp_position.dtype, copy=False),
        task.grasp_rotation[task.objects[rows, nearest]],
        config.ignore_roll,
    )
    reached = is_success(distance, angle, config.success_distance_m, config.success_angle_deg)
    return reached & (nearest != 0)


def _positions(task: "ReachTask") -> Array:
    """Return x and y of the visible targets, the wanted one first, (n, m, 2) [m]."""
    xp = array_namespace(task.position)
    return xp.concat([task.position[:, None], task.other_position], axis=1)


def _nearest_object(task: "ReachTask") -> tuple[Array, Array]:
    """Return which visible target's grasp point is nearest, (n,) int64, and that point, (n, 3)."""
    xp = array_namespace(task.position)
    grasp = target_places(task.scene, _positions(task)) + task.grasp_offset[task.objects]
    way = grasp - task.simulator.tcp_position[:, None]
    nearest = xp.argmin(xp.sum(way * way, axis=2), axis=1)
    return nearest, grasp[xp.arange(nearest.shape[0], device=nearest.device), nearest]


def target_positions(task: "ReachTask", selection: Selection) -> Array:
    """Return x and y of all K targets, hidden ones at that of the wanted one, (m, K, 2) [m]."""
    xp = array_namespace(task.position)
    others, there = selection.take(task.others), selection.take(task.other_position)
    shape = (others.shape[0], len(task.scene.targets), 2)
    places = xp.broadcast_to(selection.take(task.position)[:, None], shape)
    for j in range(others.shape[1]):
        visible = (others[:, j, None] == task.target_numbers)[..., None]
        places = xp.where(visible, there[:, j, None], places)
    return places


def check_objects(episodes: Episodes, count: int) -> None:
    """Check that episodes show as many objects as an environment.

    Raises:
        UserError: they were drawn for another number.
    """
    given = episodes.others.shape[1] + 1
    if given != count:
        raise UserError(
            f"The episodes show {given} objects, and this environment shows {count}; draw them "
            "with its config."
        )
