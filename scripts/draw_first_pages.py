"""Draw images of tutorials and guides: film strips, a report, and answers to questions.

python -m scripts.draw_first_pages           # writes to docs/images; needs Playwright and Chromium
python -m scripts.draw_first_pages answers   # one kind of them: films, report or answers
"""

import base64
import re
import shutil
import sys
import tempfile
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from knowarm.cli.main import main as knowarm
from knowarm.report import write_report
from knowarm.study.pack import unpack_study

IMAGES = Path("docs/images")
COLOURS = 200
"""Colours of an image, which keep it small."""
GRAPH = """head,relation,tail
mug,usedFor,drinking
wine_glass,usedFor,drinking
kettle,usedFor,boiling
lamp,usedFor,reading
book,usedFor,reading
"""


def draw_films(folder: Path) -> None:
    """Draw film strips of the first agent, of the oracle, and of the task of one's own."""
    strip = ["--strip", str(folder / "first-agent.png")]
    agent = ["--agent", "zoo/tiago-full-fast"]
    knowarm(["view", *agent, "--episodes", "2", "--seed", "4", *strip])
    strip = ["--strip", str(folder / "oracle-irb120.png")]
    knowarm(["view", "irb120", "--episodes", "3", "--seed", "4", *strip])
    strip = ["--strip", str(folder / "axes.png"), "--axes"]
    knowarm(["view", "tiago", "--targets", "bottle", "--episodes", "1", *strip])
    strip = ["--strip", str(folder / "own-task.png")]
    task = ["--task", "examples.own_task.hover:Hover"]
    knowarm(["view", "irb120", *task, "--episodes", "1", *strip])


def draw_report(folder: Path) -> None:
    """Draw the first page of a report."""
    study = unpack_study(Path("docs/results/paper.tar.xz"), folder / "paper")
    write_report([study], folder / "report.html")
    _photograph(folder / "report.html", height=860)


def draw_answers(folder: Path) -> None:
    """Draw the page of an answer by a graph of one's own, and the images of another answer."""
    graph = folder / "kitchen.csv"
    graph.write_text(GRAPH, encoding="utf-8")
    page = folder / "own-graph.html"
    run = "zoo/irb120-choose-answers-fast"
    asked = [run, "usedFor drinking and not hasColor red", "--graph", str(graph)]
    knowarm(["ask", *asked, "--scene", "3", "--page", str(page)])
    _stop_film(page)
    _photograph(page, height=750)
    page = folder / "ask.html"
    run = "zoo/irb120-choose-subgraph-fast"
    asked = [run, "something to drink from that is not blue"]
    knowarm(["ask", *asked, "--page", str(page)])
    _stop_film(page)
    _photograph(page, height=800, part=".pictures")


KINDS = {"films": draw_films, "report": draw_report, "answers": draw_answers}


def _stop_film(page: Path) -> None:
    """Replace the film of a page by its last image."""
    text = page.read_text(encoding="utf-8")
    found = re.search('data:image/webp;base64,([^"]+)', text)
    assert found is not None
    film = Image.open(BytesIO(base64.b64decode(found[1])))
    film.seek(getattr(film, "n_frames", 1) - 1)
    last = BytesIO()
    film.save(last, "PNG")
    address = "data:image/png;base64," + base64.b64encode(last.getvalue()).decode()
    page.write_text(text.replace(found[0], address), encoding="utf-8")


def _photograph(page: Path, height: int, part: str | None = None) -> None:
    """Write a PNG file of the first screen of a page, or of a part of it, beside the page."""
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=shutil.which("chromium"))
        opened = browser.new_page(viewport={"width": 1000, "height": height})
        opened.goto(page.as_uri())
        opened.wait_for_timeout(1_000)
        target = opened.locator(part) if part else opened
        target.screenshot(path=page.with_suffix(".png"))
        browser.close()


def main() -> None:
    """Write the images of the kinds that are named, by default of all."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind in sys.argv[1:] or KINDS:
            KINDS[kind](folder)
        for path in sorted(folder.glob("*.png")):
            image = Image.open(path).convert("RGB")
            # An octree keeps the grey of the background and the colours of thin lines.
            image = image.quantize(COLOURS, Image.Quantize.FASTOCTREE)
            image.save(IMAGES / path.name, optimize=True)
            print(f"Wrote {IMAGES / path.name}")


if __name__ == "__main__":
    main()
