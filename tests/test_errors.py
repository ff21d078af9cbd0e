import pytest

from knowarm.errors import UserError, packages_of, unknown_name


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
