"""The package's source as syntax trees, for the tests about the source itself."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "src" / "knowarm"


@cache
def files(*folders: str, suffix: str = ".py") -> dict[str, str]:
    """Return the texts of all files of the given folders of the repository, by path."""
    found = {}
    for folder in folders:
        for path in sorted((ROOT / folder).rglob(f"*{suffix}")):
            if "_build" not in path.parts:
                found[path.relative_to(ROOT).as_posix()] = path.read_text(
                    encoding="utf-8"
                )
    return found


@cache
def modules() -> dict[str, ast.Module]:
    """Return the syntax tree of every module of the package, by its path in the package."""
    prefix = SOURCE.relative_to(ROOT).as_posix() + "/"
    return {
        path.removeprefix(prefix): ast.parse(text)
        for path, text in files("src/knowarm").items()
    }


def dotted(path: str) -> str:
    """Return a module's full name: ``learn/ppo.py`` is ``knowarm.learn.ppo``."""
    return ".".join(["knowarm", *path.removesuffix(".py").split("/")]).removesuffix(
        ".__init__"
    )


@cache
def names() -> dict[str, str]:
    """Return the paths of all modules by full name."""
    return {dotted(path): path for path in modules()}


def package(path: str) -> str:
    """Return the package right below ``knowarm`` that a module lies in; "" at the root."""
    return path.split("/")[0] if "/" in path else ""


def imported(path: str, tree: ast.Module) -> Iterator[str]:
    """Yield the full name of everything that a module imports, also inside functions.

    ``from a import b`` gives ``a.b``, whether b is a module or a name. Modules that are imported by
    name count as well: ``import_module("a.b")``, "a.b:Name", and "b:Name" for a module beside it.
    """
    parents = dotted(path).split(".")
    if path.split("/")[-1] != "__init__.py":
        parents.pop()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = parents[: len(parents) - node.level + 1] if node.level else []
            start = ".".join([*base, *([node.module] if node.module else [])])
            yield from (f"{start}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(
            "import_module"
        ):
            if isinstance(node.args[0], ast.Constant):
                yield node.args[0].value
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            module, _, name = node.value.partition(":")
            beside = ".".join([*parents, module])
            if name.isidentifier() and (module in names() or beside in names()):
                yield module if module in names() else beside


def edges(path: str, tree: ast.Module) -> set[str]:
    """Return the paths of the modules that a module imports.

    A name that is imported from a package's ``__init__`` is an edge to the ``__init__``; a module
    that is imported from there is an edge to this module only.
    """
    found = set()
    for name in imported(path, tree):
        while name.startswith("knowarm") and name not in names():
            name = name.rpartition(".")[0]
        if name in names():
            found.add(names()[name])
    return found - {path}
