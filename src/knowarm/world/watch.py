"""Live view of an agent in MuJoCo's web viewer."""

import copy
import time
from collections.abc import Callable
from itertools import cycle

import mujoco
import numpy as np

from knowarm.errors import UserError
from knowarm.private_apis import guarded_web_viewer
from knowarm.world.agents.scripted import AgentProtocol
from knowarm.world.appearance import TargetColours
from knowarm.world.compose import CONTROL_PERIOD_S
from knowarm.world.episodes import Episodes
from knowarm.world.play import play_steps
from knowarm.world.vector_env import ReachVectorEnv
from knowarm.world.web_access import WebAccess

WAIT_S = 0.1
"""Time between two looks at whether a browser is there [s]."""

PAUSE_S = 1.0
"""Time that the end of an episode is shown [s]."""

FAR_BELOW_M = -100.0
"""Height at which hidden targets are placed [m]."""


def watch(
    agent: AgentProtocol,
    env: ReachVectorEnv,
    episodes: Episodes,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    open_browser: bool = True,
    on_episode: Callable[[int], None] = lambda number: None,
) -> None:
    """Serve the viewer until it is closed or interrupted; blocks.

    Playing starts when a browser shows the page, and the episodes are played again and again.

    Args:
        agent: chooses the actions.
        env: the environment, n = 1.
        episodes: what to play, one after the other, at the speed of the real robot.
        host: address to listen on; see `WebAccess` for others than the loopback.
        port: port of the page; 0 for the first free one from 8080.
        open_browser: open the page in the user's browser.
        on_episode: called with the number of each episode when it starts.

    Raises:
        UserError: ``mujoco-studio`` is not installed, or the address cannot be used.
    """
    try:
        from mujoco.studio import launch_web
        from mujoco.studio.viewer_protocol import ViewerConfig
    except ImportError as error:
        raise UserError(
            f"The web viewer needs mujoco-studio ({error}): pip install mujoco-studio. Or record "
            "with --video or --strip, which need no viewer."
        ) from None
    access = WebAccess(host, port)
    # The viewer binds in a thread, whose errors would not arrive here.
    listener = access.bind()
    config = ViewerConfig(
        title=f"KnowArm: {env.scene.robot.name}",
        gfx="web",
        http_port=access.port,
        open_browser=open_browser,
    )
    # The browser reloads its page for another model, so one model is kept as long as no target
    # changes its colour: hidden targets are placed far below the floor.
    model, data = None, None
    colours = tuple(0 for _ in env.scene.targets)
    guards = (lambda *given: listener, access.guard, access.announce, access.open_browser)
    with guarded_web_viewer(*guards), launch_web.launch(config) as viewer:
        for number in cycle(range(len(episodes))):
            for moment in play_steps(agent, env, episodes[number : number + 1]):
                if moment.step == 0:
                    on_episode(number)
                    if (current := _current_colours(env, colours)) != colours or model is None:
                        colours = current
                        model = _coloured_model(env, colours)
                        data = mujoco.MjData(model)
                        viewer.set_model(model, data=data)
                _copy_pose(env, data)
                while not access.connected.is_set():
                    if not _show(viewer, WAIT_S):
                        return
                if moment.step > 0 and not _show(viewer, CONTROL_PERIOD_S):
                    return
            if not _show(viewer, PAUSE_S):
                return


def _show(viewer: object, seconds: float) -> bool:
    """Keep the viewer synchronized for some seconds; return False if it was closed."""
    end = time.monotonic() + seconds
    while True:
        if not viewer.is_running():  # type: ignore[attr-defined]
            return False
        viewer.sync()  # type: ignore[attr-defined]
        left = end - time.monotonic()
        if left <= 0:
            return True
        time.sleep(min(left, 0.02))


def _current_colours(env: ReachVectorEnv, colours: tuple[int, ...]) -> tuple[int, ...]:
    """Return the colour index of each target, updated for the current episode."""
    task, now = env.task, list(colours)
    now[int(task.target[0])] = int(task.colour[0])
    for target, colour in zip(task.others[0], task.other_colour[0], strict=True):
        now[int(target)] = int(colour)
    return tuple(now)


def _coloured_model(env: ReachVectorEnv, colours: tuple[int, ...]) -> mujoco.MjModel:
    """Copy the model with every target visible, each in its colour."""
    scene, model = env.scene, copy.copy(env.scene.model)
    every = np.arange(len(colours))
    rgba = TargetColours(scene)(every, np.array(colours))
    model.geom_matid[:] = -1
    model.geom_rgba[:] = rgba[0]
    for k in every:
        of_target = scene.geom_target == k
        model.geom_rgba[of_target] = rgba[k, of_target]
    return model


def _copy_pose(env: ReachVectorEnv, data: mujoco.MjData) -> None:
    """Copy the pose of environment 0 into the viewer's data."""
    batch, scene = env.simulation.batch, env.scene
    data.qpos[:] = batch.bind("qpos")[0]
    data.mocap_pos[:] = batch.bind("mocap_pos")[0]
    data.mocap_quat[:] = batch.bind("mocap_quat")[0]
    hidden = ~np.isin(np.arange(len(scene.targets)), env.task.objects[0])
    data.mocap_pos[scene.target_mocap[hidden], 2] = FAR_BELOW_M
    mujoco.mj_forward(env.scene.model, data)
