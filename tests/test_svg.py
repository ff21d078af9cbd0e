import xml.etree.ElementTree as ET

import pytest

from knowarm import svg


def test_elements_escape_text_and_round_numbers():
    markup = svg.element(
        "g", svg.label(1.0, 2.005, "a < b"), class_="x", fill=None, stroke_width=1
    )
    assert (
        markup == '<g class="x" stroke-width="1"><text x="1" y="2">a &lt; b</text></g>'
    )
    assert (
        svg.element("rect", width=float("nan"), id='"')
        == '<rect width="0" id="&quot;"/>'
    )
    assert svg.hover("x & y") == "<title>x &amp; y</title>"


def test_paths():
    assert (
        svg.path([(0.0, 1.0), (2.5, 3.0)], fill="none")
        == '<path d="M0 1L2.5 3" fill="none"/>'
    )
    area = svg.band([(0, 1), (1, 1)], [(0, 0), (1, 0)])
    assert area == '<path d="M0 1L1 1L1 0L0 0Z"/>'
    assert svg.curve((0.0, 1.0), (2.0, 3.0)) == '<path d="M0 1C1 1 1 3 2 3"/>'


def test_a_document_is_well_formed_and_described():
    text = svg.document(
        10, 20.5, "A & B", svg.element("circle", r=1), description="one circle"
    )
    root = ET.fromstring(text)
    assert root.get("viewBox") == "0 0 10 20.5"
    assert root.get("aria-label") == "A & B"
    assert root.find("{http://www.w3.org/2000/svg}desc").text == "one circle"
    inline = svg.drawing(10, 20, "A", class_="chart")
    assert "xmlns" not in inline
    assert ET.fromstring(inline).get("class") == "chart"


def test_text_width_grows_with_the_font():
    assert svg.text_width("mug") == pytest.approx(3 * 0.57 * 13)
    assert svg.text_width("mug", 26) == pytest.approx(2 * svg.text_width("mug"))


def test_characters_that_xml_cannot_hold_are_left_out():
    text = "a\x00\x08\x0b\x1f\x1b[31m\ud800\uffff b<c\t\n"
    drawn = svg.label(1, 2, text, class_="x\x01y") + svg.hover(text)
    parsed = ET.fromstring(f"<svg>{drawn}</svg>")
    assert parsed[0].text == "a[31m b<c\t\n"
    assert parsed[0].get("class") == "xy"
