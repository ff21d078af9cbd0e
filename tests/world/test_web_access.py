"""The web viewer answers this machine only, waits for a browser, and plays until it is stopped."""

import http.client
import logging
import re
import socket
import subprocess
import sys
from contextlib import nullcontext
from email.message import Message
from unittest.mock import Mock

import pytest

from knowarm.errors import UserError
from knowarm.world.agents import RandomAgent
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.compose import CONTROL_PERIOD_S
from knowarm.world.viewing import watch as watching
from knowarm.world.viewing.watch import listen, refusal

pytest.importorskip("mujoco.studio.web.web_server", exc_type=ImportError)
from mujoco.studio import launch_web
from websockets.sync.client import connect  # installed with mujoco-studio


def headers(**values):
    message = Message()
    for name, value in values.items():
        message[name] = value
    message.get_all = lambda name, get=message.get_all: get(name) or []
    return message


@pytest.mark.parametrize("host", ["localhost:8080", "127.0.0.1:8080", "localhost:9000"])
def test_names_of_this_machine_are_answered(host):
    assert refusal("/", headers(Host=host)) is None
    assert refusal("/", headers(Host=host, **{"Sec-Fetch-Site": "none"})) is None  # typed
    assert refusal("/state", headers(Host=host, Origin=f"http://{host}")) is None


@pytest.mark.parametrize(
    ("path", "values"),
    [
        ("/", {"Host": "evil.example:8080"}),  # DNS rebinding
        ("/", {"Host": "localhost.evil.example:8080"}),
        ("/", {}),
        ("/state", {"Host": "localhost:8080", "Origin": "http://evil.example"}),
        ("/state", {"Host": "localhost:8080", "Origin": "null"}),
        ("/ui", {"Host": "localhost:8080", "Origin": "http://localhost:3000"}),
        ("/drop", {"Host": "localhost:8080", "Origin": "http://localhost:8080"}),
        ("//x/drop", {"Host": "localhost:8080"}),
        ("/?q=usedFor", {"Host": "localhost:8080", "Sec-Fetch-Site": "cross-site"}),  # an image
        ("/", {"Host": "localhost:8080", "Sec-Fetch-Site": "same-site"}),
        ("/", {"Host": "[::1"}),
        ("//[", {"Host": "localhost:8080"}),
    ],
)
def test_other_requests_are_refused(path, values):
    assert refusal(path, headers(**values)) is not None


def test_a_port_that_is_taken_is_named():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UserError, match=f"cannot listen on 127.0.0.1, port {port}"):
            listen(port)


def status(port, path="/", **values):
    connection = http.client.HTTPConnection("127.0.0.1", port)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in values.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse().status
    connection.close()
    return answer


def test_an_episode_begins_once_a_browser_is_there(monkeypatch):
    shown, refused = [], []

    def guard(listener, refused_request, announce):
        listener.close()
        refused.append(refused_request)
        return nullcontext()

    def show(viewer, seconds):
        shown.append(seconds)
        if len(shown) == 5:
            refused[0]("/state", headers(Host="localhost"))
        return len(shown) < 8

    monkeypatch.setattr(watching, "WAIT_S", 7.0)  # differs from a step's time
    monkeypatch.setattr(watching, "_show", show)
    monkeypatch.setattr(watching, "local_web_viewer", guard)
    pages = []

    def launch(config, plugins):
        pages.extend(plugins)
        return nullcontext(Mock())

    monkeypatch.setattr(launch_web, "launch", launch)
    env = ArmVectorEnv(EnvConfig(dynamics="kinematic"), 1)
    episodes = evaluation_episodes(env.config, 1, seed=0)
    watching.watch(RandomAgent(), env, episodes, open_browser=False, title="random")
    assert shown == 5 * [watching.WAIT_S] + 3 * [CONTROL_PERIOD_S]
    connected = logging.makeLogRecord({"name": "WebServer", "levelno": logging.INFO})
    assert not logging.getLogger("WebServer").filter(connected)
    goal = env.running.describe(0)
    moment = rf"{goal}, step 3 of 50, \d+\.\d cm, \d+ deg"
    assert re.fullmatch(rf"random\nEpisode 1 of 1: {moment}", pages[0].text)


@pytest.mark.slow
def test_the_viewer():
    command = [sys.executable, "-m", "knowarm", "view", "--agent", "oracle", "--episodes", "1"]
    options = ["--no-browser", "--dynamics", "kinematic", "--targets", "mug"]
    viewer = subprocess.Popen([*command, *options], stdout=subprocess.PIPE, text=True)
    try:
        lines = iter(viewer.stdout.readline, "")
        url = next(line.split()[-1] for line in lines if "runs at" in line)
        assert url.startswith("http://127.0.0.1:")
        port = int(url.strip("/").rsplit(":", 1)[1])
        host = f"127.0.0.1:{port}"
        assert status(port, Host=host) == 200
        assert status(port, Host="evil.example") == 403
        assert status(port, "/model", Host=host, Origin="http://evil.example") == 403
        assert status(port, "/drop", Host=host) == 403
        # 127.0.0.2 is this machine as well: a listener on all interfaces would answer there.
        if sys.platform.startswith("linux"):
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection(("127.0.0.2", port))
        with pytest.raises(Exception, match="403"):
            connect(f"ws://{host}/state", origin="http://evil.example", open_timeout=None)
        # The viewer does not answer when a browser closes the connection.
        no_wait = {"open_timeout": None, "close_timeout": 0}
        with connect(f"ws://{host}/state", origin=f"http://{host}", **no_wait):
            played = next(line for line in lines if "Episode 1 of 1" in line)
        assert played.endswith("deg: reached\n")
        assert viewer.poll() is None
    finally:
        viewer.kill()
        viewer.communicate()
