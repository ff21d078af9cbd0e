"""Structure of the source tree: imports go one way, and registries own their names."""

import ast
from pathlib import Path

import pytest

from knowarm.experiment.agents import AGENTS
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.world.robots import ROBOTS

SOURCE = Path(__file__).parent.parent / "src" / "knowarm"
MAY_IMPORT = {
    "knowledge": set(),
    "world": set(),
    "policy": set(),
    "learn": {"policy"},
    "statistics": set(),
    "experiment": {"knowledge", "world", "policy", "learn", "statistics"},
    "study": {"learn", "experiment"},
    "report": {"knowledge", "world", "policy", "learn", "experiment", "statistics"},
    "bench": {"knowledge", "world", "policy", "learn", "experiment", "statistics", "report"}
    | {"study"},
    "cli": {"knowledge", "world", "policy", "learn", "experiment", "statistics", "report", "bench"}
    | {"study"},
}
"""Packages that each package may import, beside itself and the modules of `EVERYBODY`."""

EVERYBODY = {
    "errors",
    "config",
    "cores",
    "svg",
    "compiling",
    "private_apis",
    "seeding",
    "threads",
    "reading",
    "__version__",
}
"""Modules at the root that every package may import."""

MODULES = sorted(path for path in SOURCE.rglob("*.py") if path.parent != SOURCE)
ALL_MODULES = sorted(SOURCE.rglob("*.py"))

REGISTRIES = {
    "world/robots": set(ROBOTS),
    "experiment/agents.py": set(AGENTS),
    "experiment/algorithms.py": set(ALGORITHMS),
    "learn/config.py": set(ALGORITHMS),
}
"""Files (or folders) that own names: the registries, and the algorithms' literal tags."""

OTHER_MEANINGS = {
    # The episode's object: a column of evaluations and a key of infos.
    "": {"target"},
    # Kinds of the sources of knowledge vectors: some agents are named after theirs.
    "knowledge": {"analogy", "zeros", "random", "shuffled", "onehot", "wrong-object", "learned"}
    # Values of KnowledgeConfig.detail.
    | {"partial", "full"},
    # Values of KnowledgeConfig.detail, as arguments of the knowledge commands, and a command.
    "cli/knowledge": {"partial", "full", "subgraph"},
    # Value of EnvConfig.mesh_detail.
    "world/config.py": {"full"},
    "world/scene_image.py": {"full"},
    # A scripted agent that draws its actions.
    "world/agents": {"random"},
    # Value of PolicyConfig.knowledge_encoder, which format 1 derived from the knowledge's source.
    "policy": {"learned"},
    "experiment/migration.py": {"learned"},
    # Field of PolicyConfig.
    "experiment/run.py": {"wide"},
}
"""Words in files or folders that equal the name of an agent but mean something else there."""


def imported_parts(path: Path) -> set[str]:
    """Return the parts of knowarm that a module imports anywhere, also inside functions."""
    parts = set()
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        parts |= {name.split(".")[1] for name in names if name.startswith("knowarm.")}
    return parts


def string_constants(path: Path) -> set[str]:
    """Return the string constants of a module, without docstrings."""
    tree = ast.parse(path.read_text())
    statements = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    return {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and id(node) not in statements
    }


def lies_in(path: Path, place: str) -> bool:
    return path.relative_to(SOURCE).as_posix().startswith(place)


def relative(path: Path) -> str:
    return str(path.relative_to(SOURCE))


def test_every_folder_is_known():
    assert {path.relative_to(SOURCE).parts[0] for path in MODULES} <= set(MAY_IMPORT)


@pytest.mark.parametrize("path", MODULES, ids=relative)
def test_imports_go_one_way(path):
    part = path.relative_to(SOURCE).parts[0]
    assert imported_parts(path) <= MAY_IMPORT[part] | EVERYBODY | {part}


@pytest.mark.parametrize("path", MODULES, ids=relative)
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


@pytest.mark.parametrize("path", ALL_MODULES, ids=relative)
def test_every_module_has_a_docstring(path):
    assert ast.get_docstring(ast.parse(path.read_text()))


@pytest.mark.parametrize("path", ALL_MODULES, ids=relative)
def test_names_of_registries_occur_in_their_registry_only(path):
    refused = {
        name
        for names in REGISTRIES.values()
        for name in names
        if not any(lies_in(path, owner) for owner, owned in REGISTRIES.items() if name in owned)
    }
    for place, words in OTHER_MEANINGS.items():
        if lies_in(path, place):
            refused -= words
    assert sorted(string_constants(path) & refused) == []


def test_modules_are_of_a_readable_length():
    lines = {relative(path): len(path.read_text().splitlines()) for path in ALL_MODULES}
    assert {name: count for name, count in lines.items() if count > 350} == {}
