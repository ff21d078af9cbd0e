"""Policy server: the WebSocket protocol of openpi (msgpack with NumPy arrays), without pickle.

The server first sends its metadata. Then each message of the client is an observation, and each
answer holds ``actions``, (1, R) joint targets of the real arm. Clients of this protocol rarely say
that an episode starts: the state belongs to the connection and its ``env_id``, and a new one,
``reset: true`` or another question starts an episode, which the answer states.
"""

import contextlib
import errno
import hmac
import logging
import re
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from knowarm.asking.answers import row_of
from knowarm.deploy.contract import play_once
from knowarm.deploy.driver import shrunk
from knowarm.deploy.messages import pack, unpack
from knowarm.deploy.runner import Runner, Start
from knowarm.deploy.watch import ImageWatch
from knowarm.errors import UserError, packages_of
from knowarm.local_server import LOOPBACK, listen, refusal

with packages_of("serve", "Serving"):
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.server import Server, ServerConnection, serve

MOST_BYTES = 4 * 2**20
"""Largest message [bytes]; the connection is closed before a larger one is read."""
MOST_CONNECTIONS = 8
MOST_ENVIRONMENTS = 64
"""Values of ``env_id`` per connection, each with an episode of its own."""
MOST_SOCKETS = 64
"""Open connections, with those that have sent no key yet; each takes a thread and three files."""
EXHAUSTED = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
"""Errors of a system that has no file or memory for another connection."""
KEY = re.compile(r"[!-~]{16,}")
"""Keys: visible ASCII characters, which every client can send."""
IMAGE = "observation/image"
STATE = "observation/state"
PROMPT = "prompt"
RESET = "reset"
ENVIRONMENT = "env_id"
RESIZE = "resize"

log = logging.getLogger("knowarm.serve")
_quiet = log.getChild("websockets")
_quiet.setLevel(logging.WARNING)  # it would log every header, and so the key


class _Listener(socket.socket):
    """Listening socket that closes connections beyond `MOST_SOCKETS`, and stays when files lack.

    The loop of websockets ends at any error of ``accept``.
    """

    _open: Sequence[socket.socket] = ()

    def accept(self) -> tuple[socket.socket, Any]:
        """Return the next connection, closed already if there are too many."""
        while True:
            try:
                connection, address = super().accept()
                break
            except OSError as error:
                if error.errno not in EXHAUSTED:
                    raise
                time.sleep(0.1)
        others = [other for other in self._open if other.fileno() >= 0]
        self._open = [*others, connection]
        if len(self._open) > MOST_SOCKETS:
            connection.close()
        return connection, address


class PolicyServer:
    """Server of one policy for several clients, each with a runner of its own.

    Args:
        make_runner: makes the runner of a connection.
        host: address to listen on; any but a loopback address needs a key.
        port: 0 takes a free one.
        key: clients must send ``Authorization: Api-Key KEY``; 16 visible ASCII characters or more.
        resize: average the central square of larger images, as on request of a client.

    Raises:
        UserError: the port is taken, or there is no such key for an address that others can reach.
    """

    def __init__(
        self,
        make_runner: Callable[[], Runner],
        *,
        host: str = "127.0.0.1",
        port: int = 8000,
        key: str | None = None,
        resize: bool = False,
    ) -> None:
        self._is_local = host in LOOPBACK
        if key is None and not self._is_local:
            raise UserError(
                f"Other machines may reach {host}: give a key of at least 16 characters, which "
                "`knowarm serve` reads from the variable KNOWARM_SERVE_KEY, or serve on 127.0.0.1 "
                "and let clients connect through SSH."
            )
        if key is not None and not KEY.fullmatch(key):
            raise UserError(
                "The key must have at least 16 characters: ASCII, and no spaces."
            )
        self._make_runner = make_runner
        self._key = key
        self._resize = resize
        self._seats = threading.BoundedSemaphore(MOST_CONNECTIONS)
        # Libraries keep memory per thread, and connections come with new threads: one computes.
        self._computing = ThreadPoolExecutor(1, "policy")
        self._computing.submit(lambda: play_once(make_runner())).result()
        self._server: Server = serve(
            self._handle,
            sock=_Listener(fileno=listen([port], host).detach()),
            compression=None,
            max_size=MOST_BYTES,
            process_request=self._request,
            logger=_quiet,
        )
        self.port: int = self._server.socket.getsockname()[1]
        self._accepting = threading.Thread(
            target=self._server.serve_forever, daemon=True
        )
        self._starting = threading.RLock()  # a signal handler may close, too

    def run(self) -> None:
        """Serve until `close` or an exception such as Ctrl-C, which ends the connections.

        Raises:
            UserError: the system ended the listening socket.
        """
        try:
            self._start()
            self._accepting.join()
            if self._server.socket.fileno() >= 0:
                raise UserError(
                    f"The system stopped listening on port {self.port}: start again."
                )
        finally:
            self.close()

    def close(self) -> None:
        """Stop listening, and end the connections; one that was closed never serves again.

        Any thread and signal handler may call it, before `run` as well, but no runner: it waits for
        all of them.
        """
        self._server.socket.close()
        self._start()  # `shutdown` waits for its end
        self._server.shutdown()
        self._computing.shutdown()

    def _start(self) -> None:
        """Start the thread that accepts connections, which ends at once on a closed socket."""
        with self._starting:
            if not self._accepting.ident:
                self._accepting.start()

    def _request(self, connection: ServerConnection, request: Any) -> Any:
        """Answer ``/healthz``, and refuse pages of a browser and clients without the key."""
        if self._is_local:
            reason = refusal(request.path, request.headers)
            if reason:
                return connection.respond(403, f"{reason}\n")
        if request.path == "/healthz":
            return connection.respond(200, "OK\n")
        sent = "".join(request.headers.get_all("Authorization"))
        expected = f"Api-Key {self._key}"
        if self._key is None or hmac.compare_digest(
            sent.encode(errors="replace"), expected.encode()
        ):
            return None
        return connection.respond(
            401, "The key is missing or wrong: Authorization: Api-Key KEY\n"
        )

    def _handle(self, connection: ServerConnection) -> None:
        """Serve one connection to its end; an error is one text frame, then the connection ends."""
        client = _address(connection)
        with contextlib.suppress(ConnectionClosed):
            if not self._seats.acquire(blocking=False):
                log.warning(
                    "%s refused: %d clients are connected", client, MOST_CONNECTIONS
                )
                connection.send(
                    f"The server has {MOST_CONNECTIONS} clients; try again later."
                )
                connection.close(1013, "too many clients")
                return
            log.info("%s connected", client)
            try:
                self._serve(connection)
            except ValueError as error:
                reason = " ".join(str(error).split())
                log.warning("%s refused: %s", client, ascii(reason))
                connection.send(reason)
                connection.close(1011, "error")
            finally:
                self._seats.release()
                log.info("%s left", client)

    def _serve(self, connection: ServerConnection) -> None:
        first = self._computing.submit(self._new_episode).result()
        previous_ms = None
        episodes: dict[Any, Episode] = {}
        connection.send(pack(metadata(first.runner)))
        while True:
            begin = time.monotonic()
            message = connection.recv()
            received = time.monotonic()
            if isinstance(message, str):
                raise ValueError("messages must be binary msgpack, got text")
            observation = unpack(message)
            if not isinstance(observation, dict):
                raise ValueError("an observation must be a map")
            name = observation.get(ENVIRONMENT)
            if not isinstance(name, int | str | np.integer | None):
                raise ValueError(
                    f"{ENVIRONMENT!r} must be a number or text, got {name!r:.40}"
                )
            if name not in episodes and len(episodes) == MOST_ENVIRONMENTS:
                raise ValueError(
                    f"a connection has at most {MOST_ENVIRONMENTS} of {ENVIRONMENT!r}"
                )
            if not episodes:
                episodes[name] = first
            elif name not in episodes:
                episodes[name] = self._computing.submit(self._new_episode).result()
            answer = self._computing.submit(episodes[name].answer, observation).result()
            timing = {"infer_ms": 1e3 * (time.monotonic() - received)}
            if previous_ms is not None:
                timing["prev_total_ms"] = previous_ms
            answer["server_timing"] = timing
            connection.send(pack(answer))
            previous_ms = 1e3 * (time.monotonic() - begin)

    def _new_episode(self) -> "Episode":
        return Episode(self._make_runner(), self._resize)


def _address(connection: ServerConnection) -> str:
    """Return host and port of a client for the log."""
    try:
        host, port = connection.remote_address[:2]
    except OSError:
        return "a client that is gone"
    return f"{host}:{port}"


class Episode:
    """The episodes of one environment of a client, one after another.

    ``question`` is the row of knowledge of the present one, as its prompt was read.
    """

    def __init__(self, runner: Runner, resize: bool = False) -> None:
        self.runner = runner
        self._resize = resize
        self._images = ImageWatch(runner.contract["joints"]["mpi"])
        self._prompt: Any = None
        self.question: Any = None

    def answer(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer to one observation: joint targets (1, R), and how it was read.

        With an image of a frozen camera the targets stay, and ``hold`` says why.

        Raises:
            ValueError: the observation lacks something or does not fit the contract.
        """
        runner = self.runner
        image = observation.get(IMAGE)
        if not isinstance(image, np.ndarray):
            raise ValueError(f"the observation lacks the array {IMAGE!r}")
        if self._resize or observation.get(RESIZE) in (True,):
            image = shrunk(image, runner.contract["camera"])
        # Members of a tuple are compared: True of NumPy counts as well.
        starts = not runner.is_started or observation.get(RESET) in (True,)
        prompt = observation.get(PROMPT)
        if starts or (prompt is not None and prompt != self._prompt):
            before = self.question
            self.question = self._read(prompt)
            starts = starts or self.question != before
            self._prompt = prompt
        if starts:
            runner.reset(Start(self._angles(observation.get(STATE, ())), self.question))
            self._images = ImageWatch(runner.contract["joints"]["mpi"])
        hold = self._images.problem(image, runner.targets[0])
        if not hold:
            runner.act({"image": image[None]})
            self._images.commanded(runner.targets[0])
        return {
            "actions": runner.joint_map.to_real(runner.targets),
            "episode_start": starts,
            "reading": self.question,
            "hold": hold,
        }

    def _read(self, prompt: Any) -> Any:
        """Return the row of knowledge that a prompt means; the only one where there is one."""
        rows = self.runner.contract["knowledge"]["rows"]
        if len(rows) == 1:
            return rows[0]
        is_words = isinstance(prompt, str) and any(" " in row for row in rows)
        return row_of(prompt, rows) if is_words else prompt

    def _angles(self, state: Any) -> dict[str, float]:
        """Return the joint angles by name [rad] of what the real arm reads."""
        joint_map = self.runner.joint_map
        try:
            values = np.asarray(state, np.float64).ravel()
        except (TypeError, ValueError) as error:
            raise ValueError(f"{STATE!r} must be a list of numbers: {error}") from error
        if len(values) != len(joint_map.names):
            names = ", ".join(joint_map.names)
            raise ValueError(
                f"{STATE!r} must hold {names} as an episode starts, got {len(values)}"
            )
        angles = joint_map.from_real(values).tolist()
        return dict(zip(self.runner.joint_names, angles, strict=True))


def metadata(runner: Runner) -> dict[str, Any]:
    """Return the first message to a client: the contract, and what it has to send."""
    return {
        **runner.contract,
        "action_horizon": 1,
        "observation": {
            IMAGE: f"uint8 RGB such as {runner.image_shape}",
            STATE: f"{', '.join(runner.joint_map.names)}; read as an episode starts",
            PROMPT: "a row of knowledge.rows, or a query in plain words that means one; "
            "another one starts an episode",
            RESET: "true starts an episode; so does a new connection or another question",
            ENVIRONMENT: "number or text; each has an episode of its own",
            RESIZE: "true averages the central square of a larger image",
        },
    }
