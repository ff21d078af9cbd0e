"""The data's way is also the imports' way; nothing imports backwards."""

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parent.parent / "src" / "knowarm"
MAY_IMPORT = {
    "knowledge": set(),
    "world": set(),
    "policy": set(),
    "learn": {"policy", "world"},
    "experiment": {"knowledge", "world", "policy", "learn", "statistics", "report"},
    "statistics": set(),
    "report": {"knowledge", "world", "policy", "learn", "experiment", "statistics"},
    "bench": {"knowledge", "world", "policy", "learn", "experiment", "report"},
    "cli": {"knowledge", "world", "policy", "learn", "experiment", "statistics", "report", "bench"},
}
EVERYBODY = {"errors", "config", "cores", "private_apis", "__version__"}


def imported_parts(path: Path) -> set[str]:
    """Parts of knowarm that a module imports anywhere, also inside functions."""
    parts = set()
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        parts |= {name.split(".")[1] for name in names if name.startswith("knowarm.")}
    return parts


MODULES = sorted(path for path in SOURCE.rglob("*.py") if path.parent != SOURCE)


def test_every_folder_is_known():
    assert {path.relative_to(SOURCE).parts[0] for path in MODULES} <= set(MAY_IMPORT)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_imports_go_one_way(path):
    part = path.relative_to(SOURCE).parts[0]
    assert imported_parts(path) <= MAY_IMPORT[part] | EVERYBODY | {part}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_only_the_command_line_parses_arguments(path):
    parsers = {"argparse", "tyro"}
    tree = ast.parse(path.read_text())
    names = {
        (alias.name if isinstance(node, ast.Import) else node.module or "").split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in node.names
    }
    assert not names & parsers or path.relative_to(SOURCE).parts[0] == "cli"


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_every_module_says_what_flows(path):
    assert ast.get_docstring(ast.parse(path.read_text()))
