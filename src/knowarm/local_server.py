"""HTTP servers that only this machine reaches: their port, and the requests that they refuse."""

import re
import socket
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler
from typing import Any
from urllib.parse import urlsplit

from knowarm.errors import UserError

ADDRESS = "127.0.0.1"  # The loopback interface, which other machines cannot reach
LOOPBACK = (ADDRESS, "localhost", "::1")  # Its names
_HOST = re.compile(r"(?:127\.0\.0\.1|localhost|\[::1\])(?::\d+)?", re.IGNORECASE)
PORTS = range(8080, 8180)  # Ports that are tried if none is given
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
    "form-action 'self'; frame-ancestors 'none'; base-uri 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
}
"""Headers of every answer: a page without scripts, which no other page holds in a frame."""


class LocalHandler(BaseHTTPRequestHandler):
    """Handler of requests whose answers have the headers of a page without scripts."""

    def end_headers(self) -> None:
        """Send the headers of every answer, and the empty line after them."""
        for name, value in HEADERS.items():
            self.send_header(name, value)
        super().end_headers()


def listen(ports: Sequence[int], host: str = ADDRESS) -> socket.socket:
    """Listen on the first port that is free; 0 is one that the system chooses."""
    for port in ports:
        try:
            return socket.create_server((host, port))
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error).rstrip(".")
    raise UserError(
        f"Cannot listen on {host}, port {ports[0]}: {reason}. Give another port, or stop the "
        "program that uses it."
    )


def refusal(path: str, headers: Any) -> str | None:
    """Return why a request to the loopback interface is refused; None if it is answered.

    A page of another site that is open in the same browser could otherwise use the server through
    the user's own machine: also by its images and frames, which carry no Origin.
    """
    hosts, origins, sites, accepted = (
        headers.get_all(name) or []
        for name in ("Host", "Origin", "Sec-Fetch-Site", "Accept")
    )
    try:
        urlsplit(path)
    except ValueError:  # no address, such as //[
        return "The request is no valid one."
    if len(hosts) != 1 or not _HOST.fullmatch(hosts[0]):
        return f"This server answers only as {' or '.join(LOOPBACK)}."
    if origins not in ([], [f"http://{hosts[0]}"]) or set(sites) - {
        "same-origin",
        "none",
    }:
        return "The request comes from a page of another site."
    wanted = ",".join(accepted).lower()
    if "image/" in wanted and "text/html" not in wanted:
        # Old browsers send no Sec-Fetch-Site.
        return "The request is one for an image, and this server has none."
    return None
