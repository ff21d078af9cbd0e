"""Policy server: the WebSocket protocol of openpi (msgpack with NumPy arrays), without pickle.

The server first sends its metadata. Then each message of the client is an observation, and each
answer holds ``actions``, (1, J) joint targets. Clients of this protocol never say that an episode
starts: the state belongs to the connection, and a new connection or ``reset: true`` starts one.
"""

import contextlib
import errno
import hmac
import re
import socket
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError, packages_of
from knowarm.integrations.runner import Runner, Start
from knowarm.knowledge.queries.answers import row_of
from knowarm.world.agents.protocol import Batch, Observations
from knowarm.world.viewing.watch import LOOPBACK, refusal

with packages_of("serve", "Serving"):
    import msgpack
    from websockets.exceptions import ConnectionClosed, WebSocketException
    from websockets.sync.client import ClientConnection, connect
    from websockets.sync.server import Server, ServerConnection, serve

MOST_BYTES = 4 * 2**20
"""Largest message [bytes]; the connection is closed before a larger one is read."""
MOST_CONNECTIONS = 8
MOST_SOCKETS = 64
"""Open connections, with those that have sent no key yet; each takes a thread and three files."""
KEY = re.compile(r"[!-~]{16,}")
"""Keys: visible ASCII characters, which every client can send."""
METADATA_S, ANSWER_S = 30.0, 10.0
"""How long a client waits for the metadata of a server, and for an answer [s]."""
IMAGE, STATE, PROMPT, RESET = "observation/image", "observation/state", "prompt", "reset"
_DTYPE = re.compile(r"[<>|=]?[biuf]\d{1,2}")  # no objects, records or complex numbers


def pack(values: Any) -> bytes:
    """Pack values with NumPy arrays as openpi's clients read them."""
    return bytes(msgpack.packb(values, default=_pack_array))


def unpack(data: bytes | str) -> Any:
    """Unpack a message.

    Raises:
        ValueError: the message is text or damaged, or an array is not of plain numbers.
    """
    try:
        return msgpack.unpackb(data, object_hook=_unpack_array)
    except Exception as error:  # NumPy and msgpack raise many types
        raise ValueError(f"the message is no msgpack map of numbers and arrays: {error}") from error


def _pack_array(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        form = {b"dtype": value.dtype.str, b"shape": value.shape}
        return {b"__ndarray__": True, b"data": value.tobytes(), **form}
    if isinstance(value, np.generic):
        return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
    return list(value)


def _unpack_array(value: dict[Any, Any]) -> Any:
    if b"__ndarray__" not in value and b"__npgeneric__" not in value:
        return value
    name, shape = value[b"dtype"], value.get(b"shape", ())
    if not _DTYPE.fullmatch(name) or min(shape, default=0) < 0:
        raise ValueError(f"arrays of dtype {name!r:.20} and shape {shape!r:.40} are not read")
    dtype = np.dtype(name)
    if b"__npgeneric__" in value:
        return dtype.type(value[b"data"])
    return np.frombuffer(value[b"data"], dtype).reshape(shape)


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
                if error.errno not in (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM):
                    raise
                time.sleep(0.1)
        self._open = [*(each for each in self._open if each.fileno() >= 0), connection]
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
    ) -> None:
        if key is None and host not in LOOPBACK:
            raise UserError(
                f"Other machines may reach {host}: give a key, or serve on 127.0.0.1 and let "
                "clients connect through SSH."
            )
        if key is not None and not KEY.fullmatch(key):
            raise UserError("The key must have at least 16 characters: ASCII, and no spaces.")
        self._make_runner, self._key, self._is_closed = make_runner, key, False
        self._is_local = host in LOOPBACK
        self._seats = threading.BoundedSemaphore(MOST_CONNECTIONS)
        self._computing = threading.Lock()
        try:
            listener = socket.create_server((host, port))
            self._server: Server = serve(
                self._handle,
                sock=_Listener(fileno=listener.detach()),
                compression=None,
                max_size=MOST_BYTES,
                process_request=self._request,
            )
        except (OSError, OverflowError) as error:
            raise UserError(
                f"Cannot listen on {host}, port {port}: {getattr(error, 'strerror', error)}. Stop "
                "the other program or give another port."
            ) from error
        self.port: int = self._server.socket.getsockname()[1]

    def run(self) -> None:
        """Serve until `close` or an exception such as Ctrl-C, which ends the connections.

        Raises:
            UserError: the system ended the listening socket.
        """
        try:
            self._server.serve_forever()
            if not self._is_closed:
                raise UserError(f"The system stopped listening on port {self.port}: start again.")
        finally:
            self.close()

    def close(self) -> None:
        """Stop listening, and end the connections."""
        self._is_closed = True
        self._server.shutdown()

    def _request(self, connection: ServerConnection, request: Any) -> Any:
        """Answer ``/healthz``, and refuse pages of a browser and clients without the key."""
        if request.path == "/healthz":
            return connection.respond(200, "OK\n")
        if self._is_local and (reason := refusal(request.path, request.headers)):
            return connection.respond(403, f"{reason}\n")
        given = "".join(request.headers.get_all("Authorization")).encode(errors="replace")
        if self._key is None or hmac.compare_digest(given, f"Api-Key {self._key}".encode()):
            return None
        return connection.respond(401, "The key is missing or wrong: Authorization: Api-Key KEY\n")

    def _handle(self, connection: ServerConnection) -> None:
        """Serve one connection to its end; an error is one text frame, then the connection ends."""
        with contextlib.suppress(ConnectionClosed):
            if not self._seats.acquire(blocking=False):
                connection.send(f"The server has {MOST_CONNECTIONS} clients; try again later.")
                connection.close(1013, "too many clients")
                return
            try:
                self._serve(connection)
            except ValueError as error:
                connection.send(" ".join(str(error).split()))
                connection.close(1011, "error")
            finally:
                self._seats.release()

    def _serve(self, connection: ServerConnection) -> None:
        runner, previous_ms = self._make_runner(), None
        connection.send(pack(metadata(runner)))
        while True:
            begin = time.monotonic()
            message = connection.recv()
            received = time.monotonic()
            if isinstance(message, str):
                raise ValueError("messages must be binary msgpack, got text")
            observation = unpack(message)
            with self._computing:
                targets = act(runner, observation)
            timing = {"infer_ms": 1e3 * (time.monotonic() - received)}
            if previous_ms is not None:
                timing["prev_total_ms"] = previous_ms
            connection.send(pack({"actions": targets[None], "server_timing": timing}))
            previous_ms = 1e3 * (time.monotonic() - begin)


class Client:
    """Plays the policy of a server, with a connection per episode.

    Raises:
        UserError: no server answers, or it refuses an observation.
    """

    inputs = ("image", "words")
    training = "served"
    num_envs = MOST_CONNECTIONS

    def __init__(self, url: str) -> None:
        self._url = url
        self._joints: Any = None  # names, if the server says them
        self._links = [self._connect()]

    def reset(self, batch: Batch) -> None:
        """Start an episode of each connection with the next step."""
        while len(self._links) < batch.size:
            self._links.append(self._connect())
        if self._joints not in (None, [*batch.joints]):
            raise UserError(
                f"The policy server at {self._url} moves other joints than {[*batch.joints]}, or "
                f"in another order: {self._joints!r:.300}"
            )
        self._batch, self._reset = batch, True

    def act(self, observations: Observations) -> NDArray[np.int64]:
        """Return the levels (n, J) that lead nearest to the joint targets of the server."""
        joints = observations["joint_targets"].astype(np.float64)
        wanted = np.empty_like(joints)
        for i, image in enumerate(observations["image"]):
            seen = {IMAGE: image, STATE: joints[i], RESET: self._reset}
            if self._batch.queries is not None:
                seen[PROMPT] = self._batch.queries[i]
            wanted[i] = self._ask(self._links[i], seen)
        self._reset = False
        reached = joints[..., None] + self._batch.increments
        reached = reached.clip(*self._batch.limits[..., None])
        return np.abs(reached - wanted[..., None]).argmin(-1)

    def _connect(self) -> ClientConnection:
        try:
            link = connect(self._url, compression=None, max_size=MOST_BYTES)
            about = contextlib.ExitStack().enter_context(link).recv(METADATA_S)
        except (OSError, WebSocketException, ValueError) as error:
            raise UserError(f"No policy server answers at {self._url}: {error}.") from None
        if isinstance(about, str):  # no metadata
            raise UserError(f"The policy server at {self._url} refuses: {about:.300}")
        with contextlib.suppress(ValueError, TypeError, KeyError):  # of another library
            self._joints = unpack(about)["joints"]["names"]
        return link

    def _ask(self, link: ClientConnection, seen: dict[str, Any]) -> np.ndarray:
        """Return the joint targets (J,) that a connection answers."""
        try:
            link.send(pack(seen))
            answer = link.recv(ANSWER_S)
        except (OSError, WebSocketException) as error:
            raise UserError(f"The policy server at {self._url} has gone: {error}.") from None
        try:
            targets = np.asarray(unpack(answer)["actions"], np.float64)[0]
        except (ValueError, TypeError, KeyError, IndexError):  # a line of text, or no such array
            targets = np.array(np.nan)
        if targets.shape != seen[STATE].shape or not np.isfinite(targets).all():
            raise UserError(
                f"The policy server at {self._url} refuses, or gives no finite actions (n, "
                f"{len(seen[STATE])}): {answer!r:.300}"
            )
        return targets


def act(runner: Runner, observation: Any) -> np.ndarray:
    """Return the joint targets (J,) float64 for one observation of a client.

    Raises:
        ValueError: the observation lacks something or does not fit the contract.
    """
    if not isinstance(observation, dict):
        raise ValueError("an observation must be a map")
    image = observation.get(IMAGE)
    if not isinstance(image, np.ndarray):
        raise ValueError(f"the observation lacks the array {IMAGE!r}")
    if not runner.is_started or observation.get(RESET) in (True,):  # also of NumPy
        try:
            state = np.asarray(observation.get(STATE, ()), np.float64).ravel()
        except (TypeError, ValueError) as error:
            raise ValueError(f"{STATE!r} must be a list of numbers: {error}") from error
        if len(state) != len(runner.joint_names):
            names = ", ".join(runner.joint_names)
            raise ValueError(f"{STATE!r} must hold {names} as an episode starts, got {len(state)}")
        joints = dict(zip(runner.joint_names, state.tolist(), strict=True))
        prompt, rows = observation.get(PROMPT), runner.contract["knowledge"]["rows"]
        if isinstance(prompt, str) and len(rows) > 1 and any(" " in row for row in rows):
            prompt = row_of(prompt, rows)
        runner.reset(Start(joints, prompt))
    runner.act({"image": image[None]})
    return runner.targets[0]


def metadata(runner: Runner) -> dict[str, Any]:
    """Return the first message to a client: the contract, and what it has to send."""
    return {
        **runner.contract,
        "action_horizon": 1,
        "observation": {
            IMAGE: "uint8 RGB",
            STATE: "joint angles in the order of joints.names; read as an episode starts",
            PROMPT: "a row of knowledge.rows, or a query in plain words that means one; "
            "read as an episode starts",
            RESET: "true starts an episode; so does a new connection",
        },
    }
