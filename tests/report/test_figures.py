import re
from xml.etree import ElementTree

import numpy as np
import pytest

from knowarm.report import format
from knowarm.report.charts import (
    POINTS_AXIS,
    SUCCESS_AXIS,
    Axis,
    Scale,
    Series,
    fit,
    histograms,
    line_chart,
    near,
)
from knowarm.report.diagrams import (
    Dot,
    dot_chart,
)
from knowarm.report.format import palette, slugs
from knowarm.statistics import Interval
from knowarm.svg import text_width

XS = np.array([0.0, 1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [
        (0, 1, [0, 0.25, 0.5, 0.75, 1]),
        (-37, 82, [-25, 0, 25, 50, 75]),
        (0, 4e6, [0, 1e6, 2e6, 3e6, 4e6]),
        (0.301, 0.304, [0.301, 0.302, 0.303, 0.304]),
    ],
)
def test_ticks_are_round_and_inside(low, high, ticks):
    assert Scale(low, high, 0, 100).ticks(4) == pytest.approx(ticks)


@pytest.mark.parametrize(
    ("values", "start"), [([0.2, 1], 0), ([0.6], 0.5), ([0.93, 1], 0.9), ([], 0)]
)
def test_an_axis_of_shares_starts_below_all_values(values, start):
    assert near(SUCCESS_AXIS, values).range == (start, 1)


@pytest.mark.parametrize(
    ("axis", "ticks", "labels"),
    [
        (Axis(title="x", decimals=1), [-0.75, -0.5, 0], ["−0.75", "−0.50", "0.00"]),
        (Axis(title="x", decimals=1), [1.5, 2.0], ["1.5", "2.0"]),
        (SUCCESS_AXIS, [0, 0.25], ["0\u202f%", "25\u202f%"]),
        (POINTS_AXIS, [-0.025, 0.05], ["−2.5", "+5.0"]),
    ],
)
def test_tick_labels_are_not_rounded_to_other_values(axis, ticks, labels):
    assert axis.labels(ticks) == labels


def test_the_last_tick_label_fits_the_drawing():
    line = Series(name="a", colour="c-blue", x=np.array([0, 1.0]), y=np.array([0, 1.0]))
    root = ElementTree.fromstring(
        line_chart([line], "name", SUCCESS_AXIS, SUCCESS_AXIS)
    )
    last = max(float(t.get("x")) for t in root.iter("text") if t.text == "100\u202f%")
    assert last + text_width("100 %", 11) / 2 <= float(root.get("width"))


def test_stairs_hold_each_value_until_the_next():
    line = Series(name="a", colour="c-blue", x=XS, y=XS, stairs=True)
    markup = line_chart([line], "name", Axis(title="x"), Axis(title="y"))
    points = re.search(r'<path d="M([^"]*)" class="line"', markup)[1].split("L")
    assert len(points) == 7
    assert points[0].split()[1] == points[1].split()[1]


@pytest.mark.parametrize("step", [0.0, 1e9, -1e15])
def test_a_curve_of_one_point_has_an_axis(step):
    line = Series(name="a", colour="c-blue", x=np.array([step]), y=np.array([0.5]))
    root = ElementTree.fromstring(
        line_chart([line], "name", Axis(title="x"), Axis(title="y"))
    )
    assert root.get("width")
    ticks = [each.text for each in root.iter() if each.get("class") == "tick"]
    assert len(ticks) == len(set(ticks))


def test_a_scale_holds_what_it_was_fitted_to():
    scale = fit([3.0, float("nan"), -2.0], 0, 100)
    assert 0 < scale(-2.0) < scale(3.0) < 100
    assert fit([5.0, 5.0], 0, 100)(5.0) == 50
    assert fit([], 0, 100).low < fit([], 0, 100).high


def drawings():
    line = Series(name="a<b", colour="c-blue", x=XS, y=XS, band=(XS - 1, XS + 1))
    gap = Series(name="gap", colour="c-grey", x=XS, y=np.array([1, np.nan, 2, 3.0]))
    empty = Series(name="none", colour="c-grey", x=XS, y=np.full(4, np.nan))
    one = Series(name="one", colour="c-grey", x=XS[:1], y=XS[:1])
    axes = (Axis(title="steps & more"), Axis(title="<y>"))
    return {
        "lines": line_chart([line, gap, empty], "name", *axes),
        "one point": line_chart([one], "name", *axes),
        "dots": dot_chart(
            [
                Dot(
                    name="a&b",
                    colour="c-blue",
                    value=Interval(0.5, 0.1, 0.9),
                    single=[0.2],
                    ring=0.3,
                ),
                Dot(name="none", colour="c-grey", value=None),
            ],
            "name",
            Axis(title="x"),
        ),
    }


def test_long_names_of_rows_fit():
    name = "subgraph-shuffled"
    dot = Dot(name=name, colour="c-blue", value=Interval(0.5, 0.1, 0.9))
    root = ElementTree.fromstring(dot_chart([dot], "name", Axis(title="x")))
    (text,) = (each for each in root.iter() if each.text == name)
    assert float(text.get("x")) > 6.5 * len(name)
    longer = Dot(name=60 * "n", colour="c-blue", value=Interval(0.5, 0.1, 0.9))
    root = ElementTree.fromstring(
        dot_chart([longer], "name", POINTS_AXIS, zero=True, width=390)
    )
    (zero,) = (each for each in root.iter() if each.get("class") == "zero")
    (dot,) = (each for each in root.iter() if each.get("class") == "dot")
    right = float(root.get("viewBox").split()[2])
    assert float(zero.get("x1")) < float(dot.get("cx")) < right


@pytest.mark.parametrize("name", drawings())
def test_drawings_are_well_formed_and_finite(name):
    markup = drawings()[name]
    root = ElementTree.fromstring(markup)
    assert root.get("role") == "img"
    assert root.get("aria-label")
    assert "nan" not in markup
    assert "inf" not in re.sub(r"[a-z-]*inf[a-z]+", "", markup)


def test_a_gap_in_a_curve_is_no_line():
    markup = drawings()["lines"]
    gap = markup[markup.index('data-name="gap"') :]
    paths = re.findall(r'<path d="([^"]*)" class="line"', gap)
    assert [path.count("L") + 1 for path in paths] == [1, 2]


def test_histograms_integrate_to_one():
    samples = [np.random.default_rng(0).normal(size=5_000), np.full(10, 0.5)]
    edges, heights = histograms(samples)
    for height in heights:
        assert (height * np.diff(edges)).sum() == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize(
    ("written", "shown"),
    [
        (format.number(-1234.567), "\u22121\u202f234.57"),
        (format.number(-0.001), "0.00"),
        (format.number(float("nan")), "–"),
        (format.percent(0.5), "50.0\u202f%"),
        (format.points(0.123), "+12.3"),
        (format.points(0.0), "0.0"),
        (format.steps(4_000_000), "4\u202fM"),
        (format.steps(1_250), "1.25\u202fk"),
        (format.steps(999_700), "1\u202fM"),
        (format.p_value(0.0001), "< .001"),
        (format.p_value(0.0321), ".032"),
        (format.p_value(1.0), "1"),
        (format.text(None), "–"),
        (format.text(True), "yes"),
    ],
)
def test_numbers_are_formatted_for_people(written, shown):
    assert written == shown


def test_slugs_are_safe_and_differ():
    found = slugs(["full · fusion=film", "full/fusion film", "full+", "../x", "·"])
    assert list(found.values()) == [
        "full-fusion-film",
        "full-fusion-film-2",
        "full+",
        "x",
        "x-2",
    ]


def test_agents_keep_the_paper_s_colours_and_differ():
    names = ["bm", "partial", "full", "full · fusion=film", "mine"]
    found = palette((name, name.split(" · ")[0]) for name in names)
    assert (found["bm"], found["full"]) == ("c-orange", "c-blue")
    assert len(set(found.values())) == len(names)
