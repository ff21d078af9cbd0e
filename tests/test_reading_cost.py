"""What a reader has to parse: syntax nodes per line, and constructs that fold ideas into one line.

The ceilings are figures of the tree and follow them downwards; they never rise.
"""

import ast
import io
import tokenize
from collections import Counter

import pytest

from tests.source_tree import files

MOST_NODES_PER_LINE = 6.3
"""Syntax nodes per code line of the whole package."""

MOST_PER_1000_LINES = {
    "parallel assignment": 0.0,
    "comprehension": 25.0,
    "nested comprehension": 0.0,
    "conditional expression": 10.4,
    "sequence times bool": 0.0,
}
"""Constructs of each kind per 1,000 code lines of the whole package."""

COMPREHENSIONS = ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp

NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def is_docstring(node):
    """Return whether a statement is a text alone, such as a docstring."""
    if not isinstance(node, ast.Expr) or not isinstance(node.value, ast.Constant):
        return False
    return isinstance(node.value.value, str)


def without_docstrings_and_imports(tree):
    """Yield all nodes of a syntax tree but those of docstrings and imports."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if is_docstring(node) or isinstance(node, ast.Import | ast.ImportFrom):
            continue
        yield node
        waiting.extend(ast.iter_child_nodes(node))


def code_lines(text, tree):
    """Return the numbers of the lines that hold code, without docstrings and imports."""
    numbers = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            numbers.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(tree):
        if is_docstring(node) or isinstance(node, ast.Import | ast.ImportFrom):
            numbers.difference_update(range(node.lineno, node.end_lineno + 1))
    return numbers


def folded(node):
    """Return the names of the constructs of a node that fold several ideas into one line."""
    if isinstance(node, ast.Assign):
        both = (node.targets[0], node.value)
        return ["parallel assignment"] * all(
            isinstance(side, ast.Tuple) for side in both
        )
    if isinstance(node, COMPREHENSIONS):
        inner = [child for child in ast.walk(node) if child is not node]
        is_nested = len(node.generators) > 1 or any(
            isinstance(c, COMPREHENSIONS) for c in inner
        )
        return ["comprehension", *["nested comprehension"] * is_nested]
    if isinstance(node, ast.IfExp):
        return ["conditional expression"]
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
        is_sequence = isinstance(node.left, ast.List | ast.Tuple)
        return ["sequence times bool"] * (
            is_sequence and not isinstance(node.right, ast.Constant)
        )
    return []


def measure(text):
    """Return the number of code lines, of syntax nodes, and of each folding construct."""
    tree = ast.parse(text)
    nodes = [
        node
        for node in without_docstrings_and_imports(tree)
        if not isinstance(node, ast.expr_context)
    ]
    constructs = Counter(name for node in nodes for name in folded(node))
    return len(code_lines(text, tree)), len(nodes), constructs


def test_the_package_is_not_written_more_densely():
    lines = 0
    nodes = 0
    constructs = Counter()
    for text in files("src").values():
        counts = measure(text)
        lines += counts[0]
        nodes += counts[1]
        constructs += counts[2]
    assert nodes / lines <= MOST_NODES_PER_LINE
    rates = {name: 1000 * constructs[name] / lines for name in MOST_PER_1000_LINES}
    above = {
        name: rate for name, rate in rates.items() if rate > MOST_PER_1000_LINES[name]
    }
    assert not above, f"per 1,000 code lines: {above}, of at most {MOST_PER_1000_LINES}"


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("a, b = x, y", ["parallel assignment"]),
        ("a, b = f(x)", []),
        ("[x for x in y]", ["comprehension"]),
        ("[x for x in y for z in x]", ["comprehension", "nested comprehension"]),
        (
            "{len([z for z in x]) for x in y}",
            ["comprehension"] * 2 + ["nested comprehension"],
        ),
        ("a if b else c", ["conditional expression"]),
        ("['x'] * bool(y)", ["sequence times bool"]),
        ("[0] * 3", []),
    ],
)
def test_folding_constructs_are_found(line, names):
    assert sorted(measure(line)[2].elements()) == sorted(names)


def test_docstrings_imports_and_comments_cost_nothing():
    text = '"""Text\nof two lines."""\n\nimport os\n\n# why\nx = 1\n'
    assert measure(text)[:2] == (1, 4)
