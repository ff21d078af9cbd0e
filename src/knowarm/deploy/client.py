"""Client of a policy server: the policy of another process or library, as a policy here."""

import contextlib
from typing import Any

import numpy as np

from knowarm.arrays import Integers
from knowarm.deploy.messages import pack, unpack
from knowarm.deploy.runner import JointMap
from knowarm.deploy.serve import (
    IMAGE,
    MOST_BYTES,
    MOST_CONNECTIONS,
    PROMPT,
    RESET,
    STATE,
)
from knowarm.errors import UserError, packages_of
from knowarm.world.agents.protocol import Batch, Observations

with packages_of("serve", "Serving"):
    from websockets.exceptions import WebSocketException
    from websockets.sync.client import ClientConnection, connect

METADATA_S = 30.0
"""How long a client waits for the metadata of a server [s]."""
ANSWER_S = 10.0
"""How long it waits for an answer [s]."""


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
        self._map: JointMap | None = None
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
        self._batch = batch
        self._reset = True

    def act(self, observations: Observations) -> Integers:
        """Return the levels (n, J) that lead nearest to the joint targets of the server."""
        joints = observations["joint_targets"].astype(np.float64)
        joint_map = self._map or JointMap({"names": range(joints.shape[1])})
        real = joint_map.to_real(joints)
        wanted = np.empty_like(joints)
        for i, image in enumerate(observations["image"]):
            observation = {IMAGE: image, STATE: real[i], RESET: self._reset}
            if self._batch.queries is not None:
                observation[PROMPT] = self._batch.queries[i]
            wanted[i] = joint_map.from_real(self._ask(self._links[i], observation))
        self._reset = False
        reached = joints[..., None] + self._batch.increments
        reached = reached.clip(*self._batch.limits[..., None])
        return np.abs(reached - wanted[..., None]).argmin(-1)

    def _connect(self) -> ClientConnection:
        try:
            link = connect(self._url, compression=None, max_size=MOST_BYTES)
            about = contextlib.ExitStack().enter_context(link).recv(METADATA_S)
        except (OSError, WebSocketException, ValueError) as error:
            raise UserError(
                f"No policy server answers at {self._url}: {error}."
            ) from None
        if isinstance(about, str):  # no metadata
            raise UserError(f"The policy server at {self._url} refuses: {about:.300}")
        with contextlib.suppress(ValueError, TypeError, KeyError):  # of another library
            joints = unpack(about)["joints"]
            self._joints = list(map(str, joints["names"]))
            self._map = JointMap(joints)
        return link

    def _ask(self, link: ClientConnection, observation: dict[str, Any]) -> np.ndarray:
        """Return the joint targets (J,) that a connection answers."""
        try:
            link.send(pack(observation))
            answer = link.recv(ANSWER_S)
        except (OSError, WebSocketException) as error:
            raise UserError(
                f"The policy server at {self._url} has gone: {error}."
            ) from None
        try:
            targets = np.asarray(unpack(answer)["actions"], np.float64)[0]
        except (ValueError, TypeError, LookupError):  # a text, or no such array
            targets = np.array(np.nan)
        if targets.shape != observation[STATE].shape or not np.isfinite(targets).all():
            raise UserError(
                f"The policy server at {self._url} refuses, or gives no finite actions (n, "
                f"{len(observation[STATE])}): {answer!r:.300}"
            )
        return targets
