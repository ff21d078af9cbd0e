"""The policy server plays as in process, and stands what clients do wrong."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
import urllib.request
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from knowarm.cli.main import main
from knowarm.errors import UserError
from knowarm.integrations.contract import deployment
from knowarm.world.agents.play import play
from knowarm.world.agents.protocol import Batch
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv

pytest.importorskip("websockets")
pytest.importorskip("msgpack")

from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.sync.server import serve

from knowarm.integrations.serve import (
    MOST_CONNECTIONS,
    Client,
    PolicyServer,
    pack,
    unpack,
)

ROOT = Path(__file__).parents[2]
ZOO = ROOT / "zoo"
IMAGE = np.zeros((64, 64, 3), np.uint8)


@pytest.fixture(scope="module")
def parts(trained):
    return deployment(trained)


def started(parts, **options):
    server = PolicyServer(parts.runner, port=0, **options)
    threading.Thread(target=server.run, daemon=True).start()
    return server


@pytest.fixture(scope="module")
def server(parts):
    server = started(parts)
    yield server
    server.close()


def client(server, **options):
    return connect(f"ws://127.0.0.1:{server.port}", compression=None, max_size=None, **options)


def observation(parts, **changes):
    home = np.array(parts.contract["joints"]["home"])
    return {
        "observation/image": IMAGE,
        "observation/state": home,
        "prompt": "usedFor drinking",
    } | changes


def ask(connection, values):
    connection.send(values if isinstance(values, bytes | str) else pack(values))
    return connection.recv()


def test_served_episodes_are_those_in_process(trained, server):
    env = ArmVectorEnv(trained.config.env, 1)
    episodes = evaluation_episodes(trained.config.env, 12, 5)
    theirs = play(Client(f"ws://127.0.0.1:{server.port}"), env, episodes)
    ours = play(trained.agent, env, episodes)
    np.testing.assert_array_equal(theirs.steps.joint_positions, ours.steps.joint_positions)


def test_a_new_connection_starts_an_episode_and_clients_do_not_mix(parts, server):
    with client(server) as one, client(server) as two:
        for connection in (one, two):
            connection.recv()
        answers = [
            unpack(ask(connection, observation(parts)))["actions"]
            for connection in (one, one, two, one, two)
        ]
    first, second, other_first, _, other_second = answers
    np.testing.assert_array_equal(first, other_first)
    np.testing.assert_array_equal(second, other_second)
    assert (first != second).any()


def test_a_reset_of_numpy_starts_an_episode(parts, server):
    again = observation(parts, reset=np.True_)
    with client(server) as connection:
        connection.recv()
        answers = [
            unpack(ask(connection, each))["actions"]
            for each in (observation(parts), observation(parts), again)
        ]
    np.testing.assert_array_equal(answers[0], answers[2])
    assert (answers[0] != answers[1]).any()


def test_a_client_of_a_full_server_is_told_so(server):
    with contextlib.ExitStack() as others:
        for _ in range(MOST_CONNECTIONS):
            others.enter_context(client(server)).recv()
        with pytest.raises(UserError, match="refuses: The server has 8 clients"):
            Client(f"ws://127.0.0.1:{server.port}")


@pytest.mark.parametrize(
    "answer",
    [
        "out of memory",
        b"garbage",
        pack([1.0, 2.0]),
        pack({}),
        pack({"actions": np.zeros((0, 6))}),
        pack({"actions": np.zeros((1, 7))}),
        pack({"actions": np.zeros(6)}),
        pack({"actions": [[0.0, 1.0], [0.0]]}),
        pack({"actions": "left"}),
        pack({"actions": np.full((1, 6), np.nan)}),
    ],
)
def test_a_client_refuses_an_answer_without_joint_targets(answer):
    def reply(connection):
        connection.send(pack({}))
        connection.recv()
        connection.send(answer)

    with serve(reply, "127.0.0.1", 0) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        played = Client(f"ws://127.0.0.1:{other.socket.getsockname()[1]}")
        played.reset(Batch(env=EnvConfig(), names=np.array(["mug/red"])))
        targets = np.zeros((1, 6), np.float32)
        with pytest.raises(UserError, match=r"no finite actions \(n, 6\): "):
            played.act({"image": IMAGE[None], "joint_targets": targets})


def test_healthz(server):
    with urllib.request.urlopen(f"http://127.0.0.1:{server.port}/healthz") as answer:
        assert (answer.status, answer.read()) == (200, b"OK\n")


def packed(array):
    import msgpack

    return msgpack.packb({"observation/image": array})


OBJECTS = {b"__ndarray__": True, b"data": b"x", b"dtype": "|O", b"shape": [1]}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"observation/image": IMAGE[:32]}, "64, 64, 3) uint8, got (1, 32"),
        ({"observation/image": "no array"}, "lacks the array"),
        ({"observation/state": np.zeros(5)}, "must hold"),
        ({"observation/state": np.full(6, np.nan)}, "not finite"),
        ({"observation/state": {"a": 1}}, "must be a list of numbers"),
        ({"prompt": "usedFor flying"}, "knowledge must be"),
        (partial(packed, {b"__npgeneric__": True, b"dtype": "|i1", b"data": 300}), "msgpack"),
        (partial(packed, {b"__ndarray__": True, b"dtype": "i4,(", b"data": b""}), "msgpack"),
        (b"\xc1", "msgpack"),
        ("text", "binary"),
        (partial(packed, OBJECTS), "dtype"),
    ],
)
def test_bad_messages_get_one_line_and_the_connection_ends(parts, server, change, words):
    message = change() if callable(change) else change
    message = observation(parts, **message) if isinstance(message, dict) else message
    with client(server) as connection:
        connection.recv()
        answer = ask(connection, message)
        assert isinstance(answer, str)
        assert words in answer
        assert "\n" not in answer
        with pytest.raises(ConnectionClosed):
            connection.recv()
    assert_serves(parts, server)


def assert_serves(parts, server):
    with client(server) as connection:
        connection.recv()
        assert unpack(ask(connection, observation(parts)))["actions"].shape == (1, 6)


def test_a_message_of_a_gigabyte_is_refused_by_its_header(parts, server):
    with client(server) as connection:
        connection.recv()
        binary, masked_length, mask = b"\x82", b"\xff" + (1 << 30).to_bytes(8, "big"), bytes(4)
        connection.socket.sendall(binary + masked_length + mask)  # and not one byte of content
        with pytest.raises(ConnectionClosed) as closed:
            connection.recv(timeout=60)
        assert closed.value.rcvd.code == 1009
    assert_serves(parts, server)


def test_a_client_may_vanish_in_a_step(parts, server):
    with client(server) as connection:
        connection.recv()
        connection.send(pack(observation(parts)))
        connection.socket.close()
    assert_serves(parts, server)


@pytest.mark.slow(10)
def test_ctrl_c_ends_the_connections_too():
    # A shell that starts the tests in the background ignores Ctrl-C for all that they start.
    program = (
        "import signal as s; s.signal(s.SIGINT, s.default_int_handler); import knowarm.cli.main"
    )
    program += " as m, sys; sys.exit(m.main(sys.argv[1:]))"
    command = [sys.executable, "-c", program, "serve", str(ZOO / "irb120-full-fast"), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            address = re.search(r"ws://[\d.]+:\d+", process.stdout.readline())[0]
            with connect(address, compression=None) as connection:
                connection.recv()
                process.send_signal(signal.SIGINT)
                with pytest.raises(ConnectionClosed):
                    connection.recv(timeout=60)
            assert process.wait(60) == 130
        finally:
            process.kill()


def test_a_second_server_on_the_port_is_refused(parts, server):
    with pytest.raises(UserError, match="Cannot listen on"):
        PolicyServer(parts.runner, port=server.port)


def test_other_addresses_need_a_key(parts, capsys, monkeypatch):
    monkeypatch.delenv("KNOWARM_SERVE_KEY", raising=False)
    run = str(ZOO / "irb120-full-fast")
    assert main(["serve", run, "--host", "0.0.0.0", "--port", "0"]) == 2
    assert "key" in capsys.readouterr().err


def test_the_key_is_checked(parts):
    server = started(parts, key="secret")
    with pytest.raises(InvalidStatus):
        client(server)
    headers = {"Authorization": "Api-Key secret"}
    with client(server, additional_headers=headers) as connection:
        assert unpack(connection.recv())["action_horizon"] == 1
    server.close()


def test_the_real_openpi_client_plays(parts, server, tmp_path):
    python = os.environ.get("KNOWARM_OPENPI_PYTHON")
    if python is None:
        pytest.skip("KNOWARM_OPENPI_PYTHON names no Python with openpi-client")
    code = (ROOT / "examples" / "serve_client.py").read_text()
    code = code.replace("8000", str(server.port)).replace(
        '"observation/state": angles', '"observation/state": angles, "prompt": "usedFor drinking"'
    )
    done = subprocess.run([python, "-c", code], check=True, capture_output=True, text=True)
    assert "Last joint targets" in done.stdout
