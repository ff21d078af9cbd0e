"""Live view of an agent in MuJoCo's web viewer, for browsers on this machine only."""

import copy
import logging
import socket
import threading
import time
from collections.abc import Callable
from itertools import cycle
from typing import Any
from urllib.parse import urlsplit

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.private_apis import local_web_viewer
from knowarm.world.agents.play import PlayedStep, play_steps
from knowarm.world.agents.protocol import AgentProtocol
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.appearance import TargetColours
from knowarm.world.scene.compose import CONTROL_PERIOD_S
from knowarm.world.tasks.sampling import Episodes

ADDRESS = "127.0.0.1"  # The loopback interface, which other machines cannot reach
LOOPBACK = (ADDRESS, "localhost", "::1")  # Its names
PORTS = range(8080, 8180)  # Ports that are tried if none is given
WAIT_S = 0.1  # Time between two looks at whether a browser is there [s]
PAUSE_S = 1.0  # Time that the end of an episode is shown [s]
FAR_BELOW_M = -100.0  # Height at which hidden targets are placed [m]


def watch(
    agent: AgentProtocol,
    env: ArmVectorEnv,
    episodes: Episodes,
    *,
    port: int = 0,
    open_browser: bool = True,
    title: str = "KnowArm",
    on_end: Callable[[str], None] = lambda text: None,
) -> None:
    """Serve the viewer until it is closed or interrupted; blocks.

    Playing starts when a browser shows the page, and the episodes are played again and again, at
    the speed of the real robot, while the page says which one, and how far it is. Port 0 is the
    first free one from 8080; ``on_end`` is called with the last text of each episode, when it ends
    for the first time.
    """
    try:
        from mujoco.studio import launch_web
        from mujoco.studio.viewer_protocol import ViewerConfig
    except ImportError as error:
        raise UserError(
            f"The web viewer needs mujoco-studio ({error}): pip install mujoco-studio. Or record "
            "a video or a strip, which need no viewer."
        ) from None
    # Not every page that connects; the viewer sets the level of this logger itself.
    logging.getLogger("WebServer").addFilter(lambda record: record.levelno > logging.INFO)
    # The viewer would bind in a thread, whose errors would not arrive here.
    listener = listen(port)
    port = listener.getsockname()[1]
    connected = threading.Event()

    def refused(path: str, headers: Any) -> str | None:
        reason = refusal(path, headers)
        if reason is None and path.startswith("/state"):
            connected.set()
        return reason

    def announce(*given: Any) -> None:
        print(f"The viewer runs at http://{ADDRESS}:{port}/", flush=True)

    config = ViewerConfig(title=title, gfx="web", http_port=port, open_browser=open_browser)
    # The browser reloads its page for another model, so one model is kept as long as no target
    # changes its colour: hidden targets are placed far below the floor.
    model, data = None, None
    colours = np.zeros(len(env.scene.targets), dtype=np.int64)
    page, count = _caption(), len(episodes)
    with (
        local_web_viewer(listener, refused, announce),
        launch_web.launch(config, plugins=[page]) as viewer,
    ):
        for turn, number in enumerate(cycle(range(count))):
            for moment in play_steps(agent, env, episodes[number : number + 1]):
                if moment.step == 0:
                    current = colours.copy()
                    current[env.running.objects[0]] = env.running.colours[0]
                    if model is None or (current != colours).any():
                        colours = current
                        model = _coloured_model(env, colours)
                        data = mujoco.MjData(model)
                        viewer.set_model(model, data=data)
                _copy_pose(env, data)
                text = f"Episode {number + 1} of {count}: {_describe(env, moment)}"
                page.text = f"{title}\n{text}"
                while not connected.is_set():
                    if not _show(viewer, WAIT_S):
                        return
                if moment.step > 0 and not _show(viewer, CONTROL_PERIOD_S):
                    return
            if turn < count:
                on_end(text)
            if not _show(viewer, PAUSE_S):
                return


def _describe(env: ArmVectorEnv, moment: PlayedStep) -> str:
    """Describe what is shown: the goal, the step, distance and angle, and whether it is reached."""
    end = "" if moment.running[0] else ": reached" if moment.infos["is_success"][0] else ": failed"
    step = f"{env.running.describe(0)}, step {moment.step} of {env.config.max_episode_steps}"
    distance, angle = (moment.infos[name][0] for name in ("distance", "angle"))
    return f"{step}, {100 * distance:.1f} cm, {angle:.0f} deg{end}"


def _caption() -> Any:
    """Return a plugin of the viewer that shows its ``text`` in the page."""
    from mujoco.studio import messages, plugin
    from mujoco.studio.dear_imgui import dear_imgui as imgui

    class Caption(plugin.ViewerPlugin):
        text = ""

        @messages.handler()
        def show(self, event: messages.BuildGuiEvent) -> None:
            imgui.SetNextWindowPos(imgui.Vec2(0, 0), imgui.Cond.FirstUseEver)  # beside the arm
            imgui.Begin("Episode", flags=imgui.WindowFlags.AlwaysAutoResize)
            imgui.TextUnformatted(self.text)
            imgui.End()

    return Caption()


def listen(port: int) -> socket.socket:
    """Listen on a port of the loopback interface; 0 takes the first free one of ``PORTS``."""
    for each in [port] if port else PORTS:
        try:
            return socket.create_server((ADDRESS, each))
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error).rstrip(".")
    raise UserError(
        f"The viewer cannot listen on {ADDRESS}, port {port or PORTS[0]}: {reason}. Choose another "
        "port."
    )


def refusal(path: str, headers: Any) -> str | None:
    """Return why a request to the loopback interface is refused; None if it is answered.

    A page of another site that is open in the same browser could otherwise use the server through
    the user's own machine: also by its images and frames, which carry no Origin. Uploads of models
    to the viewer are refused as well.
    """
    hosts, origins, sites = (
        headers.get_all(name) or [] for name in ("Host", "Origin", "Sec-Fetch-Site")
    )
    try:
        names, route = [urlsplit(f"//{host}").hostname for host in hosts], urlsplit(path).path
    except ValueError:  # no address, such as [::1
        return "The request is no valid one."
    if len(names) != 1 or names[0] not in LOOPBACK:
        return f"This server answers only as {' or '.join(LOOPBACK)}."
    if origins not in ([], [f"http://{hosts[0]}"]) or set(sites) - {"same-origin", "none"}:
        return "The request comes from a page of another site."
    return "This viewer takes no models." if route == "/drop" else None


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


def _coloured_model(env: ArmVectorEnv, colours: NDArray[np.int64]) -> mujoco.MjModel:
    """Copy the model with every target visible, each in its colour."""
    scene, model = env.scene, copy.copy(env.scene.model)
    every = np.arange(len(colours))
    rgba = TargetColours(scene)(every, colours)
    model.geom_matid[:] = -1
    model.geom_rgba[:] = rgba[0]
    for k in every:
        of_target = scene.geom_target == k
        model.geom_rgba[of_target] = rgba[k, of_target]
    return model


def _copy_pose(env: ArmVectorEnv, data: mujoco.MjData) -> None:
    """Copy the pose of environment 0 into the viewer's data."""
    batch, scene = env.simulation.batch, env.scene
    data.qpos[:] = batch.bind("qpos")[0]
    data.mocap_pos[:] = batch.bind("mocap_pos")[0]
    data.mocap_quat[:] = batch.bind("mocap_quat")[0]
    hidden = ~np.isin(np.arange(len(scene.targets)), env.running.objects[0])
    bodies = scene.target_mocap[hidden]
    data.mocap_pos[bodies[bodies >= 0], 2] = FAR_BELOW_M  # free bodies are far above already
    mujoco.mj_forward(env.scene.model, data)
