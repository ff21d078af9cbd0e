"""Draw how the agents of a study learned to choose and to reach, for docs/results/choose.md.

cd docs/results && knowarm study unpack choose.tar.gz && cd ../..
python scripts/draw_choose_curves.py docs/results/choose docs/images/choose-curves.svg
"""

import sys
from importlib.resources import files
from pathlib import Path

from knowarm.report.charts import CHOICE_AXIS, SUCCESS_AXIS
from knowarm.report.collect import collect
from knowarm.report.pages.training import BOXES, curve_figure
from knowarm.svg import element, escape, label, text_width

BOX, LEGEND = BOXES["large"], 34
STYLE = files("knowarm.report") / "templates" / "style.css"


def main() -> None:
    """Draw the two curves beside each other under one legend."""
    (task,) = collect([Path(sys.argv[1])]).tasks
    parts = [element("style", escape(STYLE.read_text(encoding="utf-8")))]
    parts.append(element("rect", width="100%", height="100%", fill="#ffffff"))
    x = 46.0
    for group in task.groups:
        swatch = element("rect", x=x, y=13, width=14, height=4, fill="var(--c)")
        parts.append(element("g", swatch, class_=task.colours[group.name]))
        parts.append(label(x + 20, 20, group.name, class_="row-name"))
        x += 44 + text_width(group.name)
    for i, (key, axis) in enumerate({"choice": CHOICE_AXIS, "success": SUCCESS_AXIS}.items()):
        figure = curve_figure(task, {key: axis}, key, axis.title)
        (drawing,) = (panel.svg for panel in figure.panels if panel.only == "large")
        parts.append(element("g", drawing, transform=f"translate({i * BOX.width} {LEGEND})"))
    size = f"0 0 {2 * BOX.width} {BOX.height + LEGEND}"
    image = element("svg", *parts, viewBox=size, class_="light", xmlns="http://www.w3.org/2000/svg")
    Path(sys.argv[2]).write_text(image + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
