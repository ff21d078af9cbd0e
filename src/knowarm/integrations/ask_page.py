"""Page of a question: answers, evidence, map of places and film; written, or served for changes."""

import threading
import webbrowser
from collections.abc import Callable, Sequence
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, HTTPServer, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from PIL import Image

from knowarm.errors import UserError
from knowarm.experiment.ask import Asked
from knowarm.pictures import data_uri, encode
from knowarm.reading import replacing
from knowarm.world.viewing.watch import ADDRESS, listen, refusal

AskFunction = Callable[[str, tuple[str, ...], int | None], Asked]
"""Asks a question of a graph with edits, in a scene of that number or a suitable one."""

RED = (214, 39, 40)
FRAME_MS, LAST_MS = 100, 1_500
"""Display time of each image of the film, and of the last [ms]."""


def page(
    asked: Asked | None,
    question: str,
    edits: Sequence[str],
    *,
    live: bool,
    scene: int | None = None,
    problem: str = "",
) -> str:
    """Return the page as self-contained HTML; ``live`` adds a form."""
    loader = PackageLoader("knowarm.integrations")
    template = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    pictures = {} if asked is None else _pictures(asked)
    shown = {"live": live, "problem": problem, "scene": "" if scene is None else scene}
    found = {"asked": asked, "question": question, "edits": edits}
    return template.get_template("ask.html.j2").render(**found, **shown, **pictures)


def write_page(path: Path, asked: Asked, edits: Sequence[str]) -> None:
    """Write the page of a question to an HTML file."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"The page must be an .html file, got {path}.")
    text = page(asked, asked.answers.question, edits, live=False)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def serve_page(server: HTTPServer) -> None:
    """Open the page of `make_server` in the browser and serve it until Ctrl-C."""
    address = f"http://{ADDRESS}:{server.server_port}/"
    print(f"Ask at {address} and press Ctrl-C to stop.", flush=True)
    webbrowser.open(address)
    with server:
        server.serve_forever()


def make_server(
    ask: AskFunction,
    question: str,
    edits: tuple[str, ...] = (),
    scene: int | None = None,
    port: int = 0,
) -> HTTPServer:
    """Make a server on the loopback interface, which listens and answers one question at a time."""
    computing = threading.Lock()

    class Handler(BaseHTTPRequestHandler):
        timeout = 1.0  # [s]: browsers keep connections that ask nothing

        def do_GET(self) -> None:
            reason = refusal(self.path, self.headers)
            if reason is not None or (url := urlsplit(self.path)).path != "/":
                self.send_error(403 if reason else 404, reason)
                return
            with computing:
                body = self._page(parse_qs(url.query, keep_blank_values=True)).encode()
            with suppress(ConnectionError):  # the browser has left
                self.send_response(200)
                self.send_header("Content-Type", "text/html; charset=utf-8")
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

        def _page(self, given: dict[str, list[str]]) -> str:
            text, lines, number = question, edits, scene
            if given:
                text = given.get("q", [""])[0].strip()
                every = given.get("edit", [""])[0].splitlines()
                lines = tuple(line.strip() for line in every if line.strip())
                wanted = given.get("scene", [""])[0].strip()
                number = int(wanted) if wanted.isdecimal() and len(wanted) < 10 else None
            if not text:
                return page(None, text, lines, live=True, scene=number)
            try:
                asked = ask(text, lines, number)
            except UserError as error:
                return page(None, text, lines, live=True, scene=number, problem=str(error))
            return page(asked, text, lines, live=True, scene=number)

        def log_message(self, format: str, *arguments: Any) -> None:
            pass

    listener = listen(port)
    server = ThreadingHTTPServer(listener.getsockname(), Handler, bind_and_activate=False)
    server.socket.close()
    server.socket = listener
    server.server_name, server.server_port = ADDRESS, listener.getsockname()[1]
    return server


def _pictures(asked: Asked) -> dict[str, str]:
    """Return the first image, the map of places and the film as data URIs."""
    heat = np.zeros((*asked.heat.shape, 4), np.uint8)
    heat[..., :3] = RED
    heat[..., 3] = np.round(255 * asked.heat / asked.heat.max())
    frames = [Image.fromarray(frame.large) for frame in asked.film]
    durations = [FRAME_MS] * (len(frames) - 1) + [LAST_MS]
    film = {"save_all": True, "append_images": frames[1:], "duration": durations, "loop": 0}
    return {
        "image": data_uri("PNG", encode(frames[0], "PNG")),
        "heat": data_uri("PNG", encode(heat, "PNG")),
        "film": data_uri("WEBP", encode(frames[0], "WEBP", quality=70, method=2, **film)),
    }
