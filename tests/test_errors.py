import re

import pytest

from knowarm.errors import UserError, packages_of, shell_command, unknown_name
from tests.source_tree import SOURCE


def test_nearest_names_come_first():
    message = str(unknown_name("robot", "irb12", ["tiago", "irb120"]))
    assert (
        message
        == "Unknown robot 'irb12'. Did you mean 'irb120'? Available: irb120, tiago."
    )


def test_long_lists_are_cut_and_counted():
    message = str(unknown_name("word", "zzz", [f"w{i}" for i in range(100)]))
    assert "(100)" in message
    assert len(message) < 300


def test_user_errors_are_value_errors():
    assert issubclass(UserError, ValueError)


def test_a_package_that_is_missing_is_named_with_its_extra():
    with (
        pytest.raises(
            UserError,
            match=r"not installed \(absent_package\): pip install 'knowarm\[hub\]'",
        ),
        packages_of("hub", "The Hub"),
    ):
        import absent_package  # noqa: F401


def unquoted(text):
    """Return what a text puts into a command without `shell_command`; constants have no spaces."""
    values = re.findall(r"knowarm [a-z]+ [^\"\n]*?\{(.*?)\}", text)
    return [value for value in values if not value.isupper() and value != "kind"]


def test_every_printed_command_is_quoted():
    assert unquoted('print(f"Try: knowarm report {out} --out {page}")') == ["out"]
    assert shell_command("report", "My Arm/runs") == "knowarm report 'My Arm/runs'"
    found = {
        path.name: unquoted(path.read_text("utf-8")) for path in SOURCE.rglob("*.py")
    }
    assert {name: values for name, values in found.items() if values} == {}
