"""The policy server plays as in process, and stands what clients do wrong."""

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from dataclasses import replace
from functools import partial
from pathlib import Path
from urllib.error import HTTPError

import numpy as np
import pytest

from knowarm.cli.main import main
from knowarm.deploy.contract import deployment
from knowarm.deploy.driver import shrunk
from knowarm.errors import UserError
from knowarm.world.agents.play import play
from knowarm.world.agents.protocol import Batch
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from tests.forked import Forked

pytest.importorskip("websockets")
pytest.importorskip("msgpack")

from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException
from websockets.sync.client import connect
from websockets.sync.server import serve

from knowarm.deploy.client import Client
from knowarm.deploy.serve import (
    MOST_CONNECTIONS,
    MOST_SOCKETS,
    PolicyServer,
    pack,
    unpack,
)

ROOT = Path(__file__).parents[2]
ZOO = ROOT / "zoo"
KEY = "a-key-of-24-characters.."
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
    return connect(
        f"ws://127.0.0.1:{server.port}", compression=None, max_size=None, **options
    )


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
    np.testing.assert_array_equal(
        theirs.steps.joint_positions, ours.steps.joint_positions
    )


def test_an_arm_in_degrees_is_served_as_one_in_radians(trained, tmp_path):
    lines = [
        f'joint_{i} = {{name = "j{i}", sign = -1, offset = 7.5, unit = "deg"}}'
        for i in range(1, 7)
    ]
    (tmp_path / "map.toml").write_text("\n".join(["[joint_map]", *reversed(lines)]))
    server = started(deployment(trained, tmp_path / "map.toml"))
    env, episodes = (
        ArmVectorEnv(trained.config.env, 1),
        evaluation_episodes(trained.config.env, 6, 5),
    )
    theirs = play(Client(f"ws://127.0.0.1:{server.port}"), env, episodes)
    server.close()
    ours = play(trained.agent, env, episodes)
    np.testing.assert_array_equal(
        theirs.steps.joint_positions, ours.steps.joint_positions
    )


def test_a_frozen_camera_moves_no_arm_until_an_image_is_new(parts, server):
    def look(number, **more):
        image = IMAGE + np.uint8(number)
        seen = observation(parts, **{"observation/image": image}, **more)
        answer = unpack(ask(connection, seen))
        return answer["hold"], answer["actions"].tolist()

    for images in (1, 2, 4):
        with client(server) as connection:
            connection.recv()
            answers = [look(number % images) for number in range(60)]
            assert not answers[0][0]
            assert "the image is the same as before the arm moved" in answers[-1][0]
            assert len({str(targets) for _, targets in answers[30:]}) == 1
            assert not look(9)[0]
    with client(server) as connection:
        connection.recv()
        assert not any(look(number)[0] for number in range(40))
        assert not any(look(0, reset=True)[0] for _ in range(40))


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


def answers(parts, server, changes):
    with client(server) as connection:
        connection.recv()
        return [unpack(ask(connection, observation(parts, **each))) for each in changes]


def test_another_question_starts_an_episode_and_the_answer_says_how_it_was_read(
    parts, server
):
    prompts = [
        "usedFor drinking",
        "something to drink from",
        "usedFor heating",
        "usedFor heating",
    ]
    found = answers(parts, server, [{"prompt": prompt} for prompt in prompts])
    assert [each["episode_start"] for each in found] == [True, False, True, False]
    assert [each["reading"] for each in found] == ["usedFor drinking"] * 2 + [
        "usedFor heating"
    ] * 2
    (fresh,) = answers(parts, server, [{"prompt": "usedFor heating"}])
    np.testing.assert_array_equal(found[2]["actions"], fresh["actions"])


def test_environments_of_a_connection_do_not_share_an_episode(parts, server):
    found = answers(parts, server, [{"env_id": name} for name in (0, 1, 0, 1, "other")])
    first, other_first, second, other_second, third = (
        each["actions"] for each in found
    )
    np.testing.assert_array_equal(first, other_first)
    np.testing.assert_array_equal(first, third)
    np.testing.assert_array_equal(second, other_second)
    assert (first != second).any()


def test_larger_images_are_averaged_on_request_and_smaller_ones_refused(parts, server):
    large = np.random.default_rng(0).integers(0, 255, (128, 160, 3), np.uint8)
    small = shrunk(large, parts.contract["camera"])
    asked = [{"observation/image": large, "resize": True}, {"observation/image": small}]
    (resized, exact) = (answers(parts, server, [each])[0]["actions"] for each in asked)
    np.testing.assert_array_equal(resized, exact)
    with client(server) as connection:
        connection.recv()
        change = {"observation/image": IMAGE[:32, :32], "resize": True}
        assert "got (1, 32" in ask(connection, observation(parts, **change))


def test_a_client_of_a_full_server_is_told_so(parts):
    server = started(parts)  # of others, clients may still be leaving
    with contextlib.ExitStack() as others:
        for _ in range(MOST_CONNECTIONS):
            others.enter_context(client(server)).recv()
        with pytest.raises(UserError, match="refuses: The server has 8 clients"):
            Client(f"ws://127.0.0.1:{server.port}")


@contextlib.contextmanager
def client_of(*answers):
    """A client of a server that gives answers in turn, and then none."""

    def reply(connection):
        for answer in answers:
            connection.send(answer)
            connection.recv()
        connection.recv()

    with serve(reply, "127.0.0.1", 0) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        yield Client(f"ws://127.0.0.1:{other.socket.getsockname()[1]}")


BATCH = Batch(env=EnvConfig(), names=np.array(["mug/red"]))
SEEN = {"image": IMAGE[None], "joint_targets": np.zeros((1, 6), np.float32)}


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
    with client_of(pack({}), answer) as played:
        played.reset(BATCH)
        with pytest.raises(UserError, match=r"no finite actions \(n, 6\): "):
            played.act(SEEN)


@pytest.mark.parametrize("names", [np.arange(6), [np.arange(2)] * 6, "joints"])
def test_a_client_refuses_a_server_of_other_joints_however_it_names_them(parts, names):
    joints = dict.fromkeys(parts.contract["joints"]["names"], np.zeros(1))
    with (
        client_of(pack({"joints": {"names": names}})) as played,
        pytest.raises(UserError, match="moves other joints than"),
    ):
        played.reset(replace(BATCH, joints=joints))


def test_healthz(server):
    with urllib.request.urlopen(f"http://127.0.0.1:{server.port}/healthz") as answer:
        assert (answer.status, answer.read()) == (200, b"OK\n")


@pytest.mark.parametrize("headers", [{"Host": "evil.example"}, {"Origin": "http://a"}])
def test_healthz_answers_no_page_of_another_site(server, headers):
    request = urllib.request.Request(
        f"http://127.0.0.1:{server.port}/healthz", headers=headers
    )
    with pytest.raises(HTTPError, match="403"):
        urllib.request.urlopen(request)


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
        ({"prompt": "usedFor flying"}, "not understood"),
        ({"env_id": [1]}, "must be a number or text"),
        (
            partial(packed, {b"__npgeneric__": True, b"dtype": "|i1", b"data": 300}),
            "msgpack",
        ),
        (
            partial(packed, {b"__ndarray__": True, b"dtype": "i4,(", b"data": b""}),
            "msgpack",
        ),
        (b"\xc1", "msgpack"),
        ("text", "binary"),
        (partial(packed, OBJECTS), "dtype"),
        (partial(packed, OBJECTS | {b"dtype": "|u1", b"shape": [-1]}), "shape"),
    ],
)
def test_bad_messages_get_one_line_and_the_connection_ends(
    parts, server, change, words, caplog
):
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
    assert re.search(r"127.0.0.1:\d+ refused: ", caplog.text)
    assert_serves(parts, server)


def assert_serves(parts, server):
    with client(server) as connection:
        connection.recv()
        assert unpack(ask(connection, observation(parts)))["actions"].shape == (1, 6)


def test_a_message_of_a_gigabyte_is_refused_by_its_header(parts, server):
    with client(server) as connection:
        connection.recv()
        binary, masked_length, mask = (
            b"\x82",
            b"\xff" + (1 << 30).to_bytes(8, "big"),
            bytes(4),
        )
        # And not one byte of content
        connection.socket.sendall(binary + masked_length + mask)
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
def test_the_command_says_who_connects_and_ctrl_c_ends_the_connections_too():
    # A shell that starts the tests in the background ignores Ctrl-C for all that they start.
    program = (
        "import signal as s; s.signal(s.SIGINT, s.default_int_handler); "
        "import knowarm.cli.main"
    )
    program += " as m, sys; sys.exit(m.main(sys.argv[1:]))"
    command = [
        sys.executable,
        "-c",
        program,
        "serve",
        str(ZOO / "irb120-full-fast"),
        "--port",
        "0",
    ]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:
        try:
            address = re.search(r"ws://[\d.]+:\d+", process.stdout.readline())[0]
            with connect(address, compression=None) as connection:
                connection.recv()
                process.send_signal(signal.SIGINT)
                with pytest.raises(ConnectionClosed):
                    connection.recv(timeout=60)
            assert process.wait(60) == 130
            assert re.search(r"127.0.0.1:\d+ connected", process.stderr.read())
        finally:
            process.kill()


def test_other_addresses_need_a_key(parts, capsys, monkeypatch):
    monkeypatch.delenv("KNOWARM_SERVE_KEY", raising=False)
    run = str(ZOO / "irb120-full-fast")
    assert main(["serve", run, "--host", "0.0.0.0", "--port", "0"]) == 2
    assert "from the variable KNOWARM_SERVE_KEY" in capsys.readouterr().err


WRONG_KEYS = [
    "",
    "Api-Key",
    "Api-Key None",
    "Api-Key \xe9",
    f"Bearer {KEY}",
    f"api-key {KEY}",
    f"Api-Key  {KEY}",
    f"Api-Key {KEY[:-1]}",
    f"Api-Key {KEY}.",
    f"Api-Key {KEY.upper()}",
]


def status(server, headers, path=""):
    """Return the status with which a connection is refused."""
    with pytest.raises(InvalidStatus) as refused:
        connect(
            f"ws://127.0.0.1:{server.port}{path}",
            compression=None,
            additional_headers=headers,
        )
    return refused.value.response.status_code


def test_the_key_is_checked(parts, caplog):
    caplog.set_level("DEBUG")  # at which websockets names every header
    server = started(parts, key=KEY)
    right = ("Authorization", f"Api-Key {KEY}")
    wrong = [
        [],
        [("Authorization", KEY)],
        [right, right],
        *([("Authorization", text)] for text in WRONG_KEYS),
        [("X-Api-Key", KEY)],
        [("Cookie", f"key={KEY}")],
    ]
    with client(server, additional_headers=[right]) as connection:
        assert unpack(connection.recv())["action_horizon"] == 1
        for headers in wrong:  # beside a client that has the key
            assert status(server, headers) == 401
        for path in (f"/?key={KEY}", f"/{KEY}", f"//x:{KEY}@127.0.0.1"):
            assert status(server, [], path) == 401
    assert status(server, []) == 401, "a client that comes again"
    server.close()
    # Lines that begin with ">" are the client's.
    assert not [m for m in caplog.messages if KEY in m and not m.startswith(">")]
    assert "connected" in caplog.text


@pytest.mark.parametrize(
    "key", ["", " ", "short", 20 * "\xe9", 20 * " ", 16 * "a" + "\n"]
)
def test_a_key_that_protects_nothing_or_never_fits_is_refused(parts, key):
    with pytest.raises(UserError, match="at least 16 characters"):
        PolicyServer(parts.runner, port=0, key=key)


def test_pages_of_a_browser_are_refused(parts, server):
    given = {"Host": f"localhost:{server.port}", "Sec-Fetch-Site": "cross-site"}
    with socket.create_connection(("127.0.0.1", server.port)) as link:
        head = {
            "Upgrade": "websocket",
            "Connection": "Upgrade",
            "Sec-WebSocket-Version": "13",
        }
        head |= {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="} | given
        lines = [f"{name}: {value}" for name, value in head.items()]
        link.sendall("\r\n".join(["GET / HTTP/1.1", *lines, "", ""]).encode())
        assert link.recv(100).startswith(b"HTTP/1.1 403 ")
    assert_serves(parts, server)


def test_the_policy_is_compiled_before_a_client_comes(parts):
    """Strangers may hold all files that a process may open, and imports open files."""
    made = []
    server = PolicyServer(lambda: made.append(parts.runner()) or made[-1], port=0)
    threading.Thread(target=server.run, daemon=True).start()
    with connect(f"ws://127.0.0.1:{server.port}", compression=None) as client:
        client.recv()
        assert [runner.is_started for runner in made] == [True, False]
    server.close()


def test_one_thread_computes_for_all_connections(parts):
    """Libraries keep memory for each thread that calls them, and threads come and go here."""
    threads = set()

    def noted(function):
        def call(*arguments):
            threads.add(threading.get_ident())
            return function(*arguments)

        return call

    def make_runner():
        threads.add(threading.get_ident())
        runner = parts.runner()
        runner.reset = noted(runner.reset)
        runner.act = noted(runner.act)
        return runner

    server = PolicyServer(make_runner, port=0)
    threading.Thread(target=server.run, daemon=True).start()
    for name in (0, 1):
        with client(server) as connection:
            connection.recv()
            ask(connection, observation(parts))
            ask(connection, observation(parts, env_id=name))
    server.close()
    assert len(threads) == 1
    assert threads.isdisjoint({thread.ident for thread in threading.enumerate()})


def test_idle_sockets_neither_end_the_server_nor_cut_off_a_client(
    parts, short_handshakes
):
    """None of them sends a key; a client that is there is served on, and new ones later."""
    server = started(parts)
    with client(server) as connection:
        connection.recv()
        with contextlib.ExitStack() as idle:
            for _ in range(3 * MOST_SOCKETS):
                idle.enter_context(socket.create_connection(("127.0.0.1", server.port)))
            deadline = time.monotonic() + 20
            while (
                threading.active_count() > MOST_SOCKETS + 20
                and time.monotonic() < deadline
            ):
                time.sleep(0.1)
            assert threading.active_count() <= MOST_SOCKETS + 20
            assert unpack(ask(connection, observation(parts)))["actions"].shape == (
                1,
                6,
            )
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        with contextlib.suppress(OSError, WebSocketException):
            assert_serves(parts, server)
            break
    else:
        pytest.fail("the server takes no new client")
    server.close()


def test_a_server_without_free_files_waits_for_some(parts, monkeypatch):
    server, refusals = PolicyServer(parts.runner, port=0), [24, 24, 24]
    accept = socket.socket.accept

    def few(self):
        if refusals:
            raise OSError(refusals.pop(), "Too many open files")
        return accept(self)

    monkeypatch.setattr(socket.socket, "accept", few)
    threading.Thread(target=server.run, daemon=True).start()
    assert_serves(parts, server)
    assert not refusals
    server.close()


def test_a_server_whose_socket_the_system_ends_says_so(parts, monkeypatch):
    server = PolicyServer(parts.runner, port=0)

    def broken(self):
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(socket.socket, "accept", broken)
    with (
        socket.create_connection(("127.0.0.1", server.port)),
        pytest.raises(UserError, match="stopped listening"),
    ):
        server.run()


def closed_before(server):
    server.close()
    server.run()


def closed_twice(server):
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    server.close()
    server.close()
    thread.join()


def closed_and_run_again(server):
    threading.Timer(0.1, server.close).start()
    server.run()
    server.run()


def run_by_two(server):
    other = threading.Thread(target=server.run, daemon=True)
    other.start()
    closed_and_run_again(server)
    other.join()


def closed_by_two(server):
    threads = [threading.Thread(target=server.close, daemon=True) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    server.run()


@pytest.mark.parametrize(
    "use",
    [closed_before, closed_twice, closed_and_run_again, run_by_two, closed_by_two],
)
def test_a_server_is_closed_at_any_time_and_by_any_thread(parts, use):
    server = PolicyServer(parts.runner, port=0)
    ended = []
    waiting = threading.Thread(
        target=lambda: ended.append(use(server)), daemon=True
    )  # it would wait for ever
    waiting.start()
    waiting.join(20)
    assert ended == [None]
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", server.port))


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="a signal of Unix")
def test_a_signal_closes_a_server_in_the_thread_that_runs_it(parts, tmp_path):
    def serves():
        server = PolicyServer(parts.runner, port=0)
        signal.signal(signal.SIGTERM, lambda *_: server.close())
        term = (threading.get_ident(), signal.SIGTERM)
        threading.Timer(0.3, signal.pthread_kill, term).start()
        server.run()

    done = Forked(serves, tmp_path)
    ended = done.ended(20)
    done.process.kill()  # it would wait for ever
    assert ended
    assert done.returncode == 0, done.stderr


def test_a_long_dtype_is_refused_before_it_is_parsed():
    """It once stopped all clients for seconds."""
    text = "f8," * 1_300_000
    began = time.monotonic()
    message = packed(
        {b"__ndarray__": True, b"dtype": text, b"shape": [1], b"data": b""}
    )
    with pytest.raises(ValueError, match="are not read"):
        unpack(message)
    assert time.monotonic() - began < 1


def slowly():
    """A message in pieces, of which each arrives in time, and the last one never."""
    while True:
        yield b"."
        time.sleep(0.05)


@pytest.mark.parametrize(
    "answers",
    [[], [pack({})], [slowly()], [pack({}), slowly()]],
    ids=["nothing", "metadata alone", "slow metadata", "slow answer"],
)
def test_a_client_does_not_wait_for_a_silent_server(answers, monkeypatch):
    monkeypatch.setattr("knowarm.deploy.client.METADATA_S", 0.2)
    monkeypatch.setattr("knowarm.deploy.client.ANSWER_S", 0.2)

    def play_one():
        with client_of(*answers) as played:
            played.reset(BATCH)
            played.act(SEEN)

    with pytest.raises(UserError, match="timed out"):
        play_one()


def test_the_real_openpi_client_plays(parts, server, tmp_path):
    python = os.environ.get("KNOWARM_OPENPI_PYTHON")
    if python is None:
        pytest.skip("KNOWARM_OPENPI_PYTHON names no Python with openpi-client")
    code = (ROOT / "examples" / "serve_client.py").read_text()
    code = code.replace("8000", str(server.port)).replace(
        '"observation/state": angles',
        '"observation/state": angles, "prompt": "usedFor drinking"',
    )
    done = subprocess.run(
        [python, "-c", code], check=True, capture_output=True, text=True
    )
    assert "Last joint targets" in done.stdout
