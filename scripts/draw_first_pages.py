"""Draw the images of the tutorials: a trained arm, a report, and the answer of one's own graph.

python -m scripts.draw_first_pages    # writes to docs/images; needs Playwright and Chromium
"""

import shutil
import tempfile
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


def main() -> None:
    """Write all images."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        strip = [
            "--episodes",
            "2",
            "--seed",
            "4",
            "--strip",
            str(folder / "first-agent.png"),
        ]
        knowarm(["view", "--agent", "zoo/tiago-full-fast", *strip])
        strip = ["--episodes", "1", "--strip", str(folder / "own-task.png")]
        knowarm(["view", "irb120", "--task", "examples.own_task.hover:Hover", *strip])
        study = unpack_study(Path("docs/results/paper.tar.xz"), folder / "paper")
        write_report([study], folder / "report.html")
        (folder / "kitchen.csv").write_text(GRAPH, encoding="utf-8")
        asked = [
            "zoo/irb120-choose-answers-fast",
            "usedFor drinking and not hasColor red",
        ]
        pages = [
            "--scene",
            "3",
            "--graph",
            str(folder / "kitchen.csv"),
            "--page",
            str(folder / "own-graph.html"),
        ]
        knowarm(["ask", *asked, *pages])
        with sync_playwright() as started:
            browser = started.chromium.launch(executable_path=shutil.which("chromium"))
            for page, height in (("report", 860), ("own-graph", 700)):
                opened = browser.new_page(viewport={"width": 1000, "height": height})
                opened.goto((folder / f"{page}.html").as_uri())
                opened.wait_for_timeout(2_000)  # until the film is over
                opened.screenshot(path=folder / f"{page}.png")
            browser.close()
        for path in sorted(folder.glob("*.png")):
            image = (
                Image.open(path)
                .convert("RGB")
                .quantize(COLOURS, Image.Quantize.MAXCOVERAGE)
            )
            image.save(IMAGES / path.name, optimize=True)
            print(f"Wrote {IMAGES / path.name}")


if __name__ == "__main__":
    main()
