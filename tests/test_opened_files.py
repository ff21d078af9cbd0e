"""Files of strangers are opened where their defects are one line, and a FIFO is refused.

`knowarm.reading.reading` refuses what is no regular file; outside of it, only files that the
package or the same process has written are opened.
"""

import ast

import pytest

from tests.source_tree import modules

OPENERS = {
    "InferenceSession",
    "ZipFile",
    "load_file",
    "open",
    "read_bytes",
    "read_table",
    "read_text",
    "safe_open",
}
"""Functions and methods that open a file, whichever library they are of."""
OTHERS = {"np.load", "json.load", "tomllib.load", "pq.read_table", "pq.ParquetFile"}
READERS = {"read_bytes", "read_text", "read_table"}
"""Functions of KnowArm with these names read in `reading`; as methods they are Python's."""
NO_FILES = {
    "os.open",
    "webbrowser.open",
    "RunFolder.open",
    "logs.open",
    "self.matches.open",
}
"""What is called alike and opens no file of others, or is a reader of KnowArm."""
WITHOUT = {
    "asking/lexicon.py": "words of the package",
    "cli/tables.py": "an output",
    "cores.py": "/proc",
    "deploy/driver.py": "images of messages, in memory",
    "deploy/runner.py": "without KnowArm; regular files only",
    "experiment/csv_log.py": "its log, which it has read before",
    "fence.py": "/proc",
    "knowledge/formats/files.py": "its callers read it in `reading`",
    "knowledge/formats/tables.py": "an output",
    "knowledge/vectors/words.py": "vectors of the package",
    "knowledge/embedding.py": "opens a source of vectors",
    "learn/checkpoint.py": "writes",
    "report/figure.py": "images of the report, in memory",
    "report/pages/paper.py": "figures of the package",
    "report/write.py": "an output",
    "study/pack.py": "an output",
    "study/executor.py": "the log of a worker",
    "svg.py": "style of the package",
    "world/cache.py": "the cache of the user",
    "world/render/numeric.py": "the package itself",
    "world/tasks/asked/family/families.py": "a table of the package",
    "world/viewing/dataset.py": "images of a table that it has read, in memory",
    "world/viewing/record.py": "an output",
}
"""Modules that open files outside of `reading`, and why they may."""


def opens(call: ast.Call) -> bool:
    """Tell whether a call opens a file."""
    name = ast.unparse(call.func)
    last = name.rpartition(".")[2]
    if name in NO_FILES or (name == last and last in READERS):
        return False
    if last == "open" and not call.args and name == "open":
        return False
    return last in OPENERS or name in OTHERS


def is_reading(node: ast.With) -> bool:
    return any("reading(" in ast.unparse(item.context_expr) for item in node.items)


def fenced_in_reading(tree: ast.AST) -> set[str]:
    """Return the functions that run in the fence, within `reading`."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.With) and is_reading(node):
            for call in ast.walk(node):
                if isinstance(call, ast.Call) and ast.unparse(call.func) == "fenced":
                    names.add(ast.unparse(call.args[0]))
    return names


def unguarded(tree: ast.AST) -> list[int]:
    """Return the lines on which a file is opened outside of `reading`."""
    fenced = fenced_in_reading(tree)
    lines, waiting = [], [(tree, False)]
    while waiting:
        node, is_guarded = waiting.pop()
        is_guarded = is_guarded or (isinstance(node, ast.With) and is_reading(node))
        if isinstance(node, ast.FunctionDef):
            is_guarded = is_guarded or node.name in fenced
        if isinstance(node, ast.Call) and opens(node) and not is_guarded:
            lines.append(node.lineno)
        waiting += [(child, is_guarded) for child in ast.iter_child_nodes(node)]
    return sorted(lines)


def test_files_of_others_are_opened_in_one_way():
    found = {path: unguarded(tree) for path, tree in modules().items()}
    wrong = {
        path: lines for path, lines in found.items() if lines and path not in WITHOUT
    }
    assert not wrong, "open it in `with reading(path, remedy)`, or by `read_bytes`"
    assert not [path for path in WITHOUT if not found[path]], "no exception is needed"


@pytest.mark.parametrize(
    "code",
    [
        "open(path)",
        "path.open('rb')",
        "path.read_bytes()",
        "Path(name).read_text()",
        "np.load(path)",
        "Image.open(path)",
        "lzma.open(path)",
        "safe_open(path, 'pt')",
        "with open(path) as file: pass",
        "with writing(path): path.read_bytes()",
        "onnxruntime.InferenceSession(path)",
    ],
)
def test_the_guard_sees_every_way_to_open_a_file(code):
    assert unguarded(ast.parse(code)) == [1]
    guarded = f"with reading(path, remedy), others():\n    {code}"
    assert unguarded(ast.parse(guarded)) == []


def test_what_the_fence_runs_is_guarded_where_the_fence_is():
    code = "def opened(path):\n    return Image.open(path)\n"
    assert unguarded(ast.parse(f"{code}fenced(opened, path)")) == [2]
    assert unguarded(ast.parse(f"{code}with reading(path): fenced(other, path)")) == [2]
    assert unguarded(ast.parse(f"{code}with reading(path): fenced(opened, path)")) == []
