"""Frozen suites: what they hold does not follow the code's defaults, and covers every field."""

import json
from dataclasses import MISSING, fields, is_dataclass

import pytest

from knowarm.benchmark.freezing import freeze
from knowarm.benchmark.suites import FOLDER, parse_suite, read_suite, suite_names
from knowarm.config import to_dict
from knowarm.world.config import EnvConfig
from knowarm.world.scene.appearance import VisualRandomization
from knowarm.world.tasks.asked.query.query import AskObject
from knowarm.world.tasks.asked.query.query_source import GraphQueries

NAMES = suite_names()
CONFIGS = (EnvConfig, AskObject, GraphQueries, VisualRandomization)


def other(value):
    """Return another default of the same type."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1
    return f"other {value}" if isinstance(value, str) else value


def frozen(name):
    """Return what a suite says about each cell's task."""
    return {key: to_dict(cell.env) for key, cell in read_suite(name).cells.items()}


@pytest.mark.parametrize("name", NAMES)
def test_every_field_of_a_task_is_stored(name):
    """A new field with a default would change old suites silently: it fails here."""
    stored = json.loads((FOLDER / f"{name}.json").read_text())
    assert {key: cell["env"] for key, cell in stored["cells"].items()} == frozen(name)


def test_other_defaults_change_no_suite(monkeypatch):
    before = {name: frozen(name) for name in NAMES}
    digests = {name: read_suite(name).digest for name in NAMES}
    changed = 0
    for config in CONFIGS:
        assert is_dataclass(config)
        defaults = config.__init__.__kwdefaults__
        for field in fields(config):
            new = other(field.default)
            if (
                field.default is not MISSING
                and new != field.default
                and field.name != "kind"
            ):
                monkeypatch.setitem(defaults, field.name, new)
                changed += 1
    assert changed > 15
    assert VisualRandomization.__init__.__kwdefaults__["distractors"] == 1
    for name in NAMES:
        assert frozen(name) == before[name]
        suite = read_suite(name)
        options = {
            "training_seeds": suite.training_seeds,
            "control_episodes": suite.control_episodes,
        }
        again = freeze(name, suite.about, list(suite.cells.values()), **options)
        assert (again.digest, suite.digest) == (digests[name], digests[name])


def test_the_digest_covers_thresholds_episodes_and_graphs():
    suite = read_suite("damaged-graph-v1")
    text, arrays = suite.data
    for old, new in (
        (b'"success_distance_m": 0.05', b'"success_distance_m": 0.06'),
        (b"mug\\tusedFor\\tdrinking", b"mug\\tusedFor\\tlighting"),
    ):
        assert old in text
        assert parse_suite(text.replace(old, new), arrays).digest != suite.digest
    assert (
        parse_suite(text, arrays[:-1] + bytes([arrays[-1] ^ 1])).digest != suite.digest
    )
