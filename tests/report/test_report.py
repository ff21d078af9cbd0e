import csv
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

from knowarm.errors import UserError
from knowarm.report import write_report
from knowarm.report.blocks import Column
from knowarm.report.charts import SUCCESS_AXIS, TEMPLATES
from knowarm.report.collect import collect
from knowarm.report.format import FORMATS
from knowarm.report.pages.knowledge import _other_conditions
from knowarm.report.pages.training import curve_figure
from knowarm.statistics import Interval
from tests.report.synthetic_study import (
    LABEL,
    Size,
    Truth,
    edit_summary,
    robot_title,
    write_study,
)


class Reader(HTMLParser):
    """Collects the values of every table, the links, and what is loaded from elsewhere."""

    def __init__(self):
        super().__init__()
        self.tables: dict[str, list[dict[str, str]]] = {}
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.images_without_words = 0

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        if tag == "table":
            self.rows = self.tables.setdefault(values["data-table"], [])
        elif tag == "tr":
            self.row: dict[str, str] = {}
        elif tag == "td":
            self.row[values["data-k"]] = values["data-v"]
            for end in ("low", "high"):
                if f"data-{end}" in values:
                    self.row[f"{values['data-k']}_{end}"] = values[f"data-{end}"]
        elif tag == "a":
            self.links.append(values.get("href", ""))
        elif tag == "img":
            self.images_without_words += not values.get("alt")
        elif tag == "svg":
            self.images_without_words += not values.get("aria-label")
        if tag in ("img", "script", "iframe", "source"):
            self.loaded.append(values.get("src", ""))
        if tag == "link":
            self.loaded.append(values.get("href", ""))

    def handle_endtag(self, tag):
        if tag == "tr" and self.row:
            self.rows.append(self.row)


def read(page: Path) -> Reader:
    reader = Reader()
    reader.feed(page.read_text())
    return reader


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_page_needs_nothing_else(made):
    reader = read(made.page)
    assert all(not address or address.startswith("data:") for address in reader.loaded)
    assert "url(" not in re.sub(r"url\(data:", "", made.page.read_text())
    assert "@import" not in made.page.read_text()


def test_every_link_leads_somewhere(made):
    ids = set(re.findall(r'<section id="([^"]+)"', made.page.read_text()))
    links = read(made.page).links
    assert len(links) > 20
    for link in links:
        if link.startswith("#"):
            assert link[1:] in ids
        else:
            assert (made.page.parent / unquote(link)).exists(), link


def test_every_image_has_words(made):
    assert read(made.page).images_without_words == 0


def test_every_table_of_the_page_equals_its_csv(made):
    reader = read(made.page)
    files = {
        path.stem: path for path in (made.page.parent / "report-data").glob("*.csv")
    }
    assert set(reader.tables) == set(files)
    assert len(files) > 20
    for name, rows in reader.tables.items():
        written = rows_of(files[name])[: len(rows)]
        for shown, stored in zip(rows, written, strict=True):
            assert {key: stored[key] for key in shown} == shown


def test_the_json_holds_every_table_and_its_sources(made):
    values = json.loads(made.page.with_suffix(".json").read_text())
    for name, table in values["tables"].items():
        written = rows_of(made.page.parent / table["csv"])
        assert len(written) == len(table["rows"]), name
        for source in table["sources"]:
            assert (made.page.parent / source).exists(), source
    assert [v for v in values["verdicts"] if "training succeeded" in v["sentence"]]


def test_the_same_folders_give_the_same_bytes(made, tmp_path):
    again = write_report(made.runs, made.page.with_name("again.html"))
    first = made.page.read_text().replace("report-data", "again-data")
    assert again.read_text() == first.replace("report.json", "again.json")


def small_study(folder):
    return write_study(
        folder, Truth(success={"bm": 0.5}), seeds=2, size=Size(points=5, episodes=9)
    )


def test_a_report_replaces_its_own_files_and_no_others(tmp_path):
    runs, data = small_study(tmp_path / "runs"), tmp_path / "report-data"
    page = write_report(runs, tmp_path / "report.html")
    stored = json.loads(page.with_suffix(".json").read_text())
    assert {path.stem for path in data.iterdir()} == set(stored["tables"])
    for path in (data / "own.csv", data / "old.csv", tmp_path / "kept.csv"):
        path.write_text("mine")
    stored["tables"] |= {"old": {}, "../kept": {}}
    page.with_suffix(".json").write_text(json.dumps(stored))
    write_report(runs, page)
    assert (
        (data / "own.csv").read_text() == (tmp_path / "kept.csv").read_text() == "mine"
    )
    assert not (data / "old.csv").exists()


def test_files_of_others_are_not_overwritten(tmp_path):
    runs, other = small_study(tmp_path / "runs"), tmp_path / "report.json"
    other.write_text('{"results": [1, 2]}')
    with pytest.raises(UserError, match=r"report\.json exists and is no report"):
        write_report(runs, tmp_path / "report.html")
    assert other.read_text() == '{"results": [1, 2]}'
    other.unlink()
    table = tmp_path / "report-data" / "training-irb120-fixed-colours-ppo.csv"
    table.parent.mkdir(exist_ok=True)
    table.write_text("mine")
    with pytest.raises(UserError, match="exists, and no report wrote it"):
        write_report(runs, tmp_path / "report.html")
    assert table.read_text() == "mine"


def test_a_number_without_an_interval_is_shown_alone():
    column = Column("success", "success", "percent", interval=True)
    template = TEMPLATES.get_template("blocks.html.j2")
    cell = template.make_module({"formats": FORMATS}).cell
    several = cell(column, Interval(0.5, 0.25, 0.75).named("success"))
    assert several == '50.0 % <span class="ci">25.0 % to 75.0 %</span>'.replace(
        " %", "\u202f%"
    )
    assert "to" not in cell(column, Interval(0.5, 0.5, 0.5).named("success"))


def test_half_of_a_surrogate_pair_does_not_stop_the_report(tmp_path):
    runs = small_study(tmp_path / "runs")
    path = next(runs[0].rglob("config.json"))
    values = json.loads(path.read_text())
    values["agent"] = "full \ud800"
    path.write_text(json.dumps(values))
    write_report(runs, tmp_path / "report.html")
    assert "full ?" in (tmp_path / "report.html").read_text()
    assert (tmp_path / "report.json").exists()


def test_curves_are_drawn_from_the_values_of_their_table(made):
    page = made.page.read_text()
    rows = rows_of(
        made.page.parent / "report-data" / "training-irb120-fixed-colours-ppo.csv"
    )
    figure = page[page.index('data-figure="training-irb120-fixed-colours-ppo"') :]
    chart = re.search(
        r'<svg[^>]*aria-label="success over.*?</svg>', figure, re.DOTALL
    ).group()
    left, right, low, high, bottom, top = map(
        float, re.search(r'data-plot="([^"]*)"', chart)[1].split()
    )
    for agent in ("bm", "full"):
        series = re.search(rf'data-name="{agent}" data-points="([^"]*)">', chart)
        points = [tuple(map(float, each.split(","))) for each in series[1].split(";")]
        mine = [row for row in rows if row["agent"] == agent]
        assert points == [(float(row["step"]), float(row["success"])) for row in mine]
    drawn = re.search(r'<path d="M([^"]*)" class="line"/>', chart)[1]
    pixels = [tuple(map(float, each.split())) for each in drawn.split("L")]
    first = [row for row in rows if row["agent"] == "bm"]
    for (x, y), row in zip(pixels, first, strict=True):
        wanted = left + (float(row["step"]) - low) / (high - low) * (right - left)
        assert abs(x - wanted) < 0.01
        assert abs(y - (bottom + float(row["success"]) * (top - bottom))) < 0.01


def test_the_paper_stands_beside_ours(made):
    rows = rows_of(made.page.parent / "report-data" / "paper.csv")
    found = {(row["task"].split(" · ")[0], row["agent"]): row for row in rows}
    irb120, tiago = map(robot_title, ("irb120", "tiago"))
    assert float(found[irb120, "full"]["paper_accuracy"]) == 0.92
    assert float(found[tiago, "full"]["paper_step"]) == 24e6
    assert "doi.org/10.3390/robotics14070086" in made.page.read_text("utf-8")


def test_how_much_depends_on_vision_is_said_beside_every_agent(made):
    folder = made.page.parent / "report-data"
    rows = {
        row["agent"]: row
        for row in rows_of(folder / "vision-irb120-fixed-colours-ppo.csv")
    }
    assert set(rows) == {"bm", "partial", "full", "wide", "zeros", "random"}
    full = rows["full"]
    assert [float(full[name]) for name in ("open-loop", "blind", "frozen")] == [
        0.2,
        0.1,
        0.3,
    ]
    assert float(full["vision_gain"]) == pytest.approx(float(full["success"]) - 0.2)
    assert float(full["minus frozen"]) == pytest.approx(float(full["success"]) - 0.3)
    assert "depends on vision." in made.page.read_text()


def test_lift_tests_are_shown_by_their_thresholds(tmp_path):
    runs = write_study(
        tmp_path / "runs", Truth(success={"bm": 0.5}), seeds=2, size=Size(points=4)
    )
    for path, lifted in zip(runs, (0.1, 0.3), strict=True):
        plain = path / "evaluation" / LABEL
        others = (("near-latest", 0.01), ("near-untrained", 0.01))  # of other networks
        for label, distance in (("lift", 0.05), ("near", 0.01), *others):
            other = shutil.copytree(plain, plain.with_name(label))
            numbers = {"lifted": lifted, "grasps": 2 * lifted, "lift_pushed": 0.5}
            edit_summary(other, config={"distance_m": distance}, **numbers)
    page = write_report(runs, tmp_path / "report.html")
    (table,) = (page.parent / "report-data").glob("*lifts*.csv")
    rows = rows_of(table)
    assert [row["seeds"] for row in rows] == ["2", "2"]
    assert [
        ("within 1 cm" in row["rules"], "within 5 cm" in row["rules"]) for row in rows
    ] == [
        (False, True),
        (True, False),
    ]
    for row in rows:
        assert float(row["lifted"]) == pytest.approx(0.2)
        assert float(row["grasps"]) == pytest.approx(0.4)
        assert (row["lift_pushed"], row["lift_slipped"]) == ("0.5", "")


def test_other_conditions_compare_evaluations_by_one_rule(tmp_path):
    truth = Truth(success={"bm": 0.5, "full": 0.5})
    runs = write_study(
        tmp_path / "runs", truth, seeds=2, size=Size(points=4, tables=False)
    )
    for path in runs:
        plain = path / "evaluation" / LABEL
        other = shutil.copytree(plain, plain.with_name("sampled"))
        near = {"distance_m": 0.01} if "-bm-" in str(path) else {}
        edit_summary(other, config={"actions": "sampled"} | near)
    task = collect(runs).tasks[0]
    rows = _other_conditions(task, task.subjects[0], "")[0].rows
    assert [row["agent"] for row in rows] == ["bm", "full"]
    assert not any("difference" in row for row in rows)
    assert "within 1 cm" in rows[0]["label"]


def test_a_curve_counts_the_seeds_that_reach_each_step(tmp_path):
    truth = Truth(success={"bm": 0.5})
    runs = write_study(
        tmp_path / "runs", truth, seeds=2, size=Size(points=12, tables=False)
    )
    for name in ("evaluations.csv", "metrics.csv"):
        lines = (runs[0] / name).read_text().splitlines(keepends=True)
        (runs[0] / name).write_text("".join(lines[:7]))
    task = collect(runs).tasks[0]
    table = curve_figure(task, {"success": SUCCESS_AXIS}, "training", "").table
    assert (table.rows[0]["seeds"], table.rows[-1]["seeds"]) == (2, 1)
    config, end = (
        json.loads((runs[0] / "config.json").read_text()),
        task.runs[1].steps_done,
    )
    for run in runs:  # which makes them one task again
        config["seed"] = int(run.name)
        config |= {
            "stop_when": {"success": 1e-9, "evaluations": 1},
            "total_steps": int(end),
        }
        (run / "config.json").write_text(json.dumps(config))
    (task,) = collect(runs).tasks
    table = curve_figure(task, {"success": SUCCESS_AXIS}, "training", "").table
    assert {row["seeds"] for row in table.rows} == {2}, (
        "a run that its rule ended goes on"
    )


def test_notes_and_verdicts_say_what_follows_and_what_does_not(made):
    values = json.loads(made.page.with_suffix(".json").read_text())
    table = values["tables"]["anova-irb120-fixed-colours-ppo"]
    assert "says nothing about another training seed" in table["note"]
    assert table["rows"][0]["rates"] == 30
    irb120, tiago = map(robot_title, ("irb120", "tiago"))
    said = [verdict["sentence"] for verdict in values["verdicts"]]
    few = "cannot be decided from 1 training seed"
    assert any(each.startswith(tiago) and few in each for each in said)
    better = "full was better than the baseline bm"
    assert any(each.startswith(irb120) and better in each for each in said)
    assert "joint 1 (hinge_0): difference of means" in made.page.read_text()


def test_a_study_with_two_subjects_is_reported(tmp_path):
    success = {"bm": 0.3, "full": 0.6, "target": 0.8, "target-onehot": 0.8, "toy": 0.5}
    truth = Truth(success=success, roles={"toy": "content_control"})
    size = Size(points=6, tables=False)
    runs = write_study(tmp_path / "runs", truth, seeds=3, size=size)
    page = write_report(runs, tmp_path / "a.html")
    tables = json.loads(page.with_suffix(".json").read_text())["tables"]
    rows = tables["controls-irb120-fixed-colours-ppo"]["rows"]
    verdicts = {row["control"]: row["verdict"] for row in rows}
    assert verdicts["target-onehot"] == verdicts["target"] == "described"
    assert {row["control"]: row["role"] for row in rows}["toy"] == "content control"
    assert "controls-irb120-fixed-colours-ppo-target" in tables


def test_names_from_folders_cannot_break_the_page(tmp_path):
    runs = write_study(
        tmp_path / "<b>&'\"",
        Truth(success={"bm": 0.5, "<script>x</script>": 0.6}),
        seeds=1,
        size=Size(points=5, episodes=9),
    )
    page = write_report(runs, tmp_path / "report.html").read_text()
    assert "<script>x" not in page
    assert "<b>&'" not in page


def test_colours_stand_beside_agents_tasks_once_and_single_seeds_are_not_compared(
    tmp_path,
):
    truth = Truth(success={"bm": 0.9, "full": 0.95})
    runs = write_study(tmp_path, truth, seeds=1)
    runs += write_study(tmp_path / "tiago", truth, seeds=1, robot="tiago")
    page = write_report(runs, tmp_path / "a.html").read_text()
    first = re.search(r'<table data-table="summary">.*?</table>', page, re.S).group()
    cells = re.findall(
        r'<td data-k="(task|agent)".*?>(?:<i (class="swatch").*?></i>)?(.*?)</td>',
        first,
    )
    agents = [(mark, text) for key, mark, text in cells if key == "agent"]
    assert agents == [('class="swatch"', name) for name in ("bm", "full")] * 2
    assert [bool(text) for key, _, text in cells if key == "task"] == [True, False] * 2
    assert page.count("No differences are computed from single seeds.") == 2
    assert 'data-table="comparisons' not in page
