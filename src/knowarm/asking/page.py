"""Page of a question: answers, evidence, map of places and film; written, or served for changes."""

import threading
import webbrowser
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from http.server import HTTPServer, ThreadingHTTPServer
from operator import methodcaller
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from knowarm.asking.asker import SCENES, Asker
from knowarm.asking.judgements import Judgement
from knowarm.asking.outcome import Asked, in_words
from knowarm.asking.quotes import condition
from knowarm.asking.tidying.story import Story, read_later, tell
from knowarm.errors import UserError
from knowarm.knowledge.graph.edits import edited
from knowarm.local_server import ADDRESS, PORTS, LocalHandler, listen, refusal
from knowarm.perception.config import Unclear
from knowarm.pictures import animation, data_uri, encode
from knowarm.reading import write_text
from knowarm.svg import render_page

RED = (214, 39, 40)
FRAME_MS = 100
LAST_MS = 1_500
"""Display time of each image of the film, and of the last [ms]."""
LETTER = 7.0
PADDING = 12.0
LINE = 19.0
WIDTH = 340.0
"""Sizes of a label and of the narrowest image that it fits in [px]."""
HIGH = 100 * LINE / WIDTH
"""Height of a label, in % of the image."""
_STEPS = sorted((*range(-15, 0), *range(1, 16)), key=abs)
"""Where a label may stand, in heights from what it names, the nearest first."""
AT_ONCE = 6
"""Questions that are answered at a time: more than processes compute queries."""
BASES = {
    "stated": "the graph says it.",
    "seen": "the image or the name says it.",
    "denied": "the graph says that it is not so, by a relation such as notUsedFor.",
    "not stated": "the graph does not say it.",
}
"""On what an answer may rest, the surest first."""
_SEEN = ("the image shows", "it is ", "by its place")
"""How evidence begins that comes from the image and the name."""


@dataclass(frozen=True, kw_only=True)
class Label:
    """A name on an image: what it names, and where it stands, in % of the image."""

    text: str
    answers: bool
    right: bool
    x: float
    y: float
    left: float
    top: float
    half: float
    """Half of its width."""


class Reason(NamedTuple):
    """Objects that answer alike: on what basis, why, and with which probability."""

    names: str
    colours: str
    basis: str
    evidence: tuple[str, ...]
    probability: float


def reasons(asked: Asked) -> list[Reason]:
    """Return why objects answer: what is stated first, then what is denied, then what neither is.

    Objects with the same evidence share a row.
    """
    alike: dict[Reason, list[str]] = {}
    for name, colours, judgement in asked.rows:
        probability = round(judgement.probability, 2)
        evidence = judgement.evidence
        reason = Reason("", colours, _basis(judgement), evidence, probability)
        alike.setdefault(reason, []).append(name)
    rows = [each._replace(names=", ".join(names)) for each, names in alike.items()]
    return sorted(rows, key=lambda row: list(BASES).index(row.basis))


def _basis(judgement: Judgement) -> str:
    """Return on what a judgement rests, one of `BASES`."""
    if not judgement.is_stated:
        return "not stated"
    if judgement.is_denied:
        return "denied"
    if all(map(methodcaller("startswith", _SEEN), judgement.evidence)):
        return "seen"
    return "stated"


def place_labels(asked: Asked) -> list[Label]:
    """Place the names that a network gives, none over another one; answers come first."""
    evidence = asked.answers.evidence
    named = list(zip(asked.named, (100 * asked.points).tolist(), strict=True))
    named.sort(key=lambda item: item[0] not in evidence)
    labels: list[Label] = []
    for facet, (x, y) in named:
        text = in_words(facet)
        half = 50 * (LETTER * len(text) + PADDING) / WIDTH
        left = min(max(x, half), 100 - half)
        tops = [y + step * HIGH for step in _STEPS]
        tops = [top for top in tops if HIGH / 2 <= top <= 100 - HIGH / 2]
        free = tops
        for other in labels:
            if abs(left - other.left) < half + other.half:
                free = [top for top in free if abs(top - other.top) >= HIGH]
        label = Label(
            text=text,
            answers=facet in evidence,
            right=facet in asked.shown,
            x=x,
            y=y,
            left=left,
            top=(free or tops)[0],
            half=half,
        )
        labels.append(label)
    return labels


def page(
    asked: Asked | None,
    question: str,
    edits: Sequence[str],
    *,
    asker: Asker | None = None,
    scene: int | None = None,
    problem: str = "",
) -> str:
    """Return the page as self-contained HTML; an asker adds a form and what can be asked."""
    values: dict[str, Any] = {
        "asked": asked,
        "question": question,
        "edits": edits,
        "asker": asker,
        "condition": condition,
        "bases": BASES,
        "problem": problem,
        "scene": scene,
        "sorts": asker is not None and asker.has_chores,
    }
    if asked is not None:
        values.update(
            _pictures(asked), labels=place_labels(asked), reasons=reasons(asked)
        )
        # What a template was given is freed late, by the collector of cycles: not the whole film.
        values["asked"] = replace(asked, film=asked.film[-1:])
    elif asker is not None and not problem:
        image, facets = asker.look(min(scene or 0, SCENES - 1))
        values["image"] = data_uri("PNG", encode(image, "PNG"))
        values["standing"] = ", ".join(map(in_words, facets))
    return render_page("knowarm.asking", "ask.html.j2", **values)


def write_page(path: Path, asked: Asked, question: str, edits: Sequence[str]) -> None:
    """Write the page of a question, as it was asked, to an HTML file."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"The page must be an .html file, got {path}.")
    write_text(path, page(asked, question, edits))


def serve_page(server: HTTPServer) -> None:
    """Open the page of `make_server` in the browser and serve it until Ctrl-C."""
    address = f"http://{ADDRESS}:{server.server_port}/"
    print(f"Ask at {address} and press Ctrl-C to stop.", flush=True)
    webbrowser.open(address)
    with server:
        server.serve_forever()


def make_server(
    asker: Asker,
    question: str,
    edits: tuple[str, ...] = (),
    scene: int | None = None,
    unclear: Unclear = "seen",
    *,
    port: int = 0,
) -> HTTPServer:
    """Make a server on the loopback interface, which listens: a scene is played at a time."""
    answering = threading.BoundedSemaphore(AT_ONCE)

    class Handler(LocalHandler):
        timeout = 1.0  # [s]: browsers keep connections that ask nothing

        def do_GET(self) -> None:
            with suppress(ConnectionError):  # the browser has left
                self._answer()

        def _answer(self) -> None:
            reason = refusal(self.path, self.headers)
            if reason is not None:
                self.send_error(403, reason)
                return
            url = urlsplit(self.path)
            answer = self._page
            if url.path == "/tidy" and asker.has_chores:
                answer = self._tidy_page
            elif url.path != "/":
                self.send_error(404)
                return
            with answering:
                pairs = parse_qsl(url.query, keep_blank_values=True)
                body = answer({name: text.strip() for name, text in pairs}).encode()
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def _page(self, fields: dict[str, str]) -> str:
            text = question
            lines = edits
            number = scene
            if fields:
                text = fields.get("q", "")
                lines = _lines(fields.get("edit", ""))
                wanted = fields.get("scene", "")
                number = None
                if wanted.isdecimal() and len(wanted) < 10:
                    number = int(wanted)
            asked = None
            problem = ""
            try:
                if text:
                    asked = asker.ask(text, lines, number, unclear)
            except UserError as error:
                problem = str(error)
            return page(asked, text, lines, asker=asker, scene=number, problem=problem)

        def _tidy_page(self, fields: dict[str, str]) -> str:
            names = ("scene", "edit", "after")
            form = {name: fields.get(name, "") for name in names}
            story = Story()
            problem = ""
            if fields:
                try:
                    _tidy(asker, story, **form)
                except UserError as error:
                    problem = str(error)
            return story.page(form, problem)

        def log_message(self, format: str, *arguments: Any) -> None:
            pass

    listener = listen([port] if port else PORTS)
    server = ThreadingHTTPServer(
        listener.getsockname(), Handler, bind_and_activate=False
    )
    server.socket.close()
    server.socket = listener
    server.server_name = ADDRESS
    server.server_port = listener.getsockname()[1]
    return server


def _tidy(asker: Asker, story: Story, scene: str, edit: str, after: str) -> None:
    """Tidy a scene as a form says.

    Raises:
        UserError: a field does not fit.
    """
    number = "0" if scene == "" else scene
    if not number.isdecimal() or len(number) > 6:
        raise UserError(f"The scene is a number from 0 on, got {scene!r}.")
    graph = edited(asker.graph, _lines(edit))
    later = read_later(_lines(after))
    tell(asker.trained, graph, int(number), later=later, story=story)


def _lines(text: str) -> tuple[str, ...]:
    return tuple(filter(None, map(str.strip, text.splitlines())))


def _pictures(asked: Asked) -> dict[str, str]:
    """Return the first image, the map of places and the film as data URIs."""
    heat = np.zeros((*asked.heat.shape, 4), np.uint8)
    heat[..., :3] = RED
    heat[..., 3] = np.round(255 * asked.heat / asked.heat.max())
    frames = [frame.large for frame in asked.film]
    return {
        "image": data_uri("PNG", encode(frames[0], "PNG")),
        "heat": data_uri("PNG", encode(heat, "PNG")),
        "film": data_uri("WEBP", animation(frames, FRAME_MS, LAST_MS)),
    }
