import xml.etree.ElementTree as ET

import numpy as np

from knowarm.knowledge.heatmap import heatmap_svg

SVG = "{http://www.w3.org/2000/svg}"


def test_every_number_is_drawn_and_nan_is_blank():
    values = np.array([[1.0, -1.0], [np.nan, 0.0]])
    root = ET.fromstring(heatmap_svg(values, ["a & b", "c"], "T", "note"))
    texts = [element.text for element in root.iter(f"{SVG}text")]
    assert {"1.00", "-1.00", "0.00", "1. a & b", "T", "note"} <= set(texts)
    fills = [element.get("fill") for element in root.iter(f"{SVG}rect")][1:]
    assert fills == ["rgb(178,24,43)", "rgb(33,102,172)", "rgb(255,255,255)"]
