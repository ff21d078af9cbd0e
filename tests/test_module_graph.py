"""Modules and folders of the package, type-checking and lazy imports included, form no circle."""

import ast
from collections import deque

from tests.source_tree import SOURCE, edges, modules


def module_graph():
    """Return the paths of the modules that each module imports."""
    graph = {path: edges(path, tree) for path, tree in modules().items()}
    # What an __init__ imports on first use of a name is written in its stub.
    for stub in SOURCE.rglob("__init__.pyi"):
        path = stub.relative_to(SOURCE).with_suffix(".py").as_posix()
        graph[path] |= edges(path, ast.parse(stub.read_text(encoding="utf-8")))
    return graph


def shortest_circles(graph):
    """Return, for every module on a circle, a shortest one through it; each circle once."""
    found = {}
    for start in graph:
        queue, before = deque([start]), {}
        while queue and start not in before:
            node = queue.popleft()
            for target in sorted(graph[node]):
                if target not in before:
                    before[target] = node
                    queue.append(target)
        if start in before:
            circle = [start]
            while before[circle[-1]] != start:
                circle.append(before[circle[-1]])
            found.setdefault(frozenset(circle), [start, *reversed(circle)])
    return sorted(found.values(), key=len)


def folder_graph(graph):
    """Return the folders and modules that each one beside them imports.

    Modules that import each other are seen as what holds them in the folder that both are in: a
    folder stands for all that is in it, a module directly in the folder for itself.
    """
    folders = {}
    for path, targets in graph.items():
        for target in targets:
            pairs = zip(parts(path), parts(target), strict=False)
            mine, theirs = next((a, b) for a, b in pairs if a != b)
            folders.setdefault(mine, set()).add(theirs)
            folders.setdefault(theirs, set())
    return folders


def parts(path):
    """Return the folders that a path is in, from the outermost, and the path."""
    names = path.split("/")
    return ["/".join(names[:count]) for count in range(1, len(names) + 1)]


def test_the_shortest_circles_of_a_graph():
    graph = {"a": {"b"}, "b": {"c", "d"}, "c": {"a", "b"}, "d": set(), "e": {"a"}}
    assert shortest_circles(graph) == [["b", "c", "b"], ["a", "b", "c", "a"]]


def test_no_module_imports_itself_by_way_of_others():
    circles = shortest_circles(module_graph())
    assert not circles, "\n".join(" -> ".join(circle) for circle in circles[:20])


def test_no_folder_imports_itself_by_way_of_others():
    circles = shortest_circles(folder_graph(module_graph()))
    assert not circles, "\n".join(" -> ".join(circle) for circle in circles[:20])


def test_folders_that_import_each_other_are_found_at_every_depth():
    """Also where their modules form no circle."""
    graph = {
        "a/x/1.py": {"a/y/1.py"},
        "a/y/2.py": {"a/x/2.py"},
        "a/x/2.py": {"a/3.py", "b.py"},
    }
    assert folder_graph(graph)["a/x"] == {"a/y", "a/3.py"}
    assert shortest_circles(folder_graph(graph)) == [["a/x", "a/y", "a/x"]]
    graph["a/3.py"] = {"a/x/1.py"}
    assert ["a/x", "a/3.py", "a/x"] in shortest_circles(folder_graph(graph))


def test_the_graph_is_complete():
    graph = module_graph()
    assert "learn/losses.py" in graph["learn/ppo.py"]  # at the top of a module
    assert "cli/train.py" in graph["cli/main.py"]  # by name, in a table of commands
    assert "experiment/run.py" in graph["__init__.py"]  # by the stub
    assert "learn/ppo.py" in graph["learn/__init__.py"]
    assert sum(map(len, graph.values())) > len(graph)
