"""HTTP servers that only this machine reaches: their port, and the requests that they refuse."""

import socket
from http.server import BaseHTTPRequestHandler
from typing import Any
from urllib.parse import urlsplit

from knowarm.errors import UserError

ADDRESS = "127.0.0.1"  # The loopback interface, which other machines cannot reach
LOOPBACK = (ADDRESS, "localhost", "::1")  # Its names
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


def listen(port: int) -> socket.socket:
    """Listen on a port of the loopback interface; 0 takes the first free one of ``PORTS``."""
    candidates = [port] if port else PORTS
    for candidate in candidates:
        try:
            return socket.create_server((ADDRESS, candidate))
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error).rstrip(".")
    raise UserError(
        f"The server cannot listen on {ADDRESS}, port {candidates[0]}: {reason}. Choose another "
        "port."
    )


def refusal(path: str, headers: Any) -> str | None:
    """Return why a request to the loopback interface is refused; None if it is answered.

    A page of another site that is open in the same browser could otherwise use the server through
    the user's own machine: also by its images and frames, which carry no Origin.
    """
    hosts = headers.get_all("Host") or []
    origins = headers.get_all("Origin") or []
    sites = headers.get_all("Sec-Fetch-Site") or []
    accepted = ",".join(headers.get_all("Accept") or [])
    try:
        names = [urlsplit(f"//{host}").hostname for host in hosts]
        urlsplit(path)
    except ValueError:  # no address, such as [::1
        return "The request is no valid one."
    if len(names) != 1 or names[0] not in LOOPBACK:
        return f"This server answers only as {' or '.join(LOOPBACK)}."
    if origins not in ([], [f"http://{hosts[0]}"]) or set(sites) - {
        "same-origin",
        "none",
    }:
        return "The request comes from a page of another site."
    if "image/" in accepted and "text/html" not in accepted:
        # Old browsers send no Sec-Fetch-Site.
        return "The request is one for an image, and this server has none."
    return None
