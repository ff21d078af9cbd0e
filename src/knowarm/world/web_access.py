"""Access to the web viewer: the address it listens on, and which requests it answers."""

import hmac
import secrets
import socket
import threading
import webbrowser
from collections.abc import Callable
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from knowarm.errors import UserError

LOOPBACK = ("localhost", "127.0.0.1", "::1")
"""Names of this machine that other machines cannot reach."""

FIRST_PORT, PORTS = 8080, 100
"""Ports that are tried if none is given."""

COOKIE = "knowarm-viewer"
"""Cookie with the token, set by the page's address."""


class WebAccess:
    """One address with its rules.

    Requests must name this machine as their Host and, if a page sends them, come from the viewer's
    own page: otherwise a page of another site that is open in the same browser could use the viewer
    through the user's own machine. On other addresses than the loopback, every request must carry a
    token. Uploads of models are refused everywhere.

    Args:
        host: address to listen on.
        port: 0 takes the first free port from `FIRST_PORT`.

    Attributes:
        url: address of the page, with the token where there is one.
        token: None on the loopback.
        connected: set once a browser shows the page.
    """

    def __init__(self, host: str, port: int) -> None:
        self.host, self.port = host, port
        self.token = None if host in LOOPBACK else secrets.token_urlsafe(16)
        self.connected = threading.Event()

    @property
    def url(self) -> str:
        """Address of the page."""
        shown = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{shown}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    def bind(self, *given: Any) -> socket.socket:
        """Listen; the arguments of the viewer's own function are ignored.

        Raises:
            UserError: the address is not of this machine, or its port is taken.
        """
        ports = [self.port] if self.port else range(FIRST_PORT, FIRST_PORT + PORTS)
        family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
        reason: OSError | None = None
        for port in ports:
            listener = socket.socket(family, socket.SOCK_STREAM)
            if hasattr(socket, "SO_EXCLUSIVEADDRUSE"):  # Windows
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
            else:
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                listener.bind((self.host, port))
                listener.listen()
            except OSError as error:
                listener.close()
                reason = error
                continue
            self.port = listener.getsockname()[1]
            return listener
        assert reason is not None
        raise UserError(
            f"The viewer cannot listen on {self.host}, port {self.port or FIRST_PORT}: "
            f"{reason.strerror or reason}. Choose another host or port."
        )

    def announce(self, *given: Any) -> None:
        """Print the address of the page."""
        print(f"The viewer runs at {self.url}", flush=True)
        if self.token:
            print("Whoever has this address can watch; the connection is not encrypted.")

    def open_browser(self, *given: Any) -> None:
        """Open the page in the user's browser."""
        threading.Thread(target=webbrowser.open, args=(self.url,), daemon=True).start()

    def guard(self, process_request: Callable[..., Any]) -> Callable[..., Any]:
        """Return the server's function for requests with these rules before it."""

        def guarded(connection: Any, request: Any) -> Any:
            path = urlsplit(request.path).path
            reason = self.refusal(request.path, request.headers)
            if reason is not None:
                return connection.respond(403, f"{reason}\n")
            if path == "/state":
                self.connected.set()
            response = process_request(connection, request)
            if response is not None and self.token and path == "/":
                response.headers["Set-Cookie"] = (
                    f"{COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"
                )
            return response

        return guarded

    def refusal(self, path: str, headers: Any) -> str | None:
        """Return why a request is refused; None if it is answered.

        Args:
            path: with the query.
            headers: of the request, with a method ``get_all``.
        """
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or len(origins) > 1:
            return "A request must name one Host and at most one Origin."
        named = urlsplit(f"//{hosts[0]}")
        try:
            is_own = named.hostname in LOOPBACK and (named.port or 80) == self.port
        except ValueError:
            is_own = False
        if self.token is None and not is_own:
            return "This viewer answers only under the address of this machine."
        if origins and origins[0] != f"http://{hosts[0]}":
            return "The request comes from a page of another site."
        if self.token is not None and not self._has_token(path, headers):
            return "Open the address that the viewer printed, with its token."
        if urlsplit(path).path == "/drop":
            return "This viewer takes no models."
        return None

    def _has_token(self, path: str, headers: Any) -> bool:
        assert self.token is not None
        given = parse_qs(urlsplit(path).query).get("token", [])
        for line in headers.get_all("Cookie"):
            try:
                cookie = SimpleCookie(line)
            except CookieError:
                continue
            given += [cookie[COOKIE].value] if COOKIE in cookie else []
        return any(hmac.compare_digest(each.encode(), self.token.encode()) for each in given)
