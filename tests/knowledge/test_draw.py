import re
import xml.etree.ElementTree as ET

import pytest

from knowarm.errors import UserError
from knowarm.knowledge import gamma, graph_of, household
from knowarm.knowledge.draw import draw_svg

SVG = "{http://www.w3.org/2000/svg}"


def test_every_entity_and_edge_is_drawn_inside_the_image():
    graph = gamma(household(), ["mug", "bottle", "cereal_box"], hops=2)
    root = ET.fromstring(draw_svg(graph, ["mug", "bottle", "cereal_box"], "A & B"))
    texts = [element.text for element in root.iter(f"{SVG}text")]
    assert {"mug", "cereal box", "light blue", "has color", "A & B"} <= set(texts)
    boxes = root.findall(f"{SVG}rect")[1:]
    assert len(boxes) == len(graph.nodes)
    assert len(root.findall(f"{SVG}path")) == len(graph)
    width, height = float(root.get("width")), float(root.get("height"))
    places = [
        tuple(float(box.get(k)) for k in ("x", "y", "width", "height")) for box in boxes
    ]
    assert all(
        x >= 0 and y >= 0 and x + w <= width and y + h <= height
        for x, y, w, h in places
    )
    for i, (x, y, w, h) in enumerate(places):
        for other_x, other_y, other_w, other_h in places[:i]:
            apart = x >= other_x + other_w or other_x >= x + w or y >= other_y + other_h
            assert apart or other_y >= y + h
    assert "bottle contains water" in root.find(f"{SVG}desc").text


def test_it_is_the_same_every_time_and_escapes_names():
    graph = graph_of([("a<b", "r&", "c")])
    assert draw_svg(graph) == draw_svg(graph)
    assert "a&lt;b" in draw_svg(graph)
    assert not re.search("nan|inf", draw_svg(graph))


def test_cycles_and_parts_that_hang_apart():
    graph = graph_of(
        [("a", "r", "b"), ("b", "r", "a"), ("x", "r", "y"), ("z", "r", "z")]
    )
    root = ET.fromstring(draw_svg(graph, ["a"]))
    assert len(root.findall(f"{SVG}rect")) == 1 + 5
    ET.fromstring(draw_svg(graph))


def test_what_cannot_be_drawn():
    with pytest.raises(UserError, match="nothing to draw"):
        draw_svg(graph_of([]))
    with pytest.raises(UserError, match=r"400 entities.*at most 300.*by objects"):
        draw_svg(graph_of((f"e{i}", "r", f"e{i + 1}") for i in range(399)))
