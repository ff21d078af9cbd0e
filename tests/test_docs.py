"""Identifiers, files, options and commands that the documentation names exist."""

import ast
import re
from collections import defaultdict
from collections.abc import Mapping
from functools import cache

import pytest

from knowarm.cli.main import COMMANDS, DOORS, find_command
from tests.source_tree import ROOT, files, names

FOREIGN = {
    "CnnPolicy",
    "EvalCallback",
    "evaluate_policy",
    "make_vec_env",
    "RecordVideo",
    "OMP_WAIT_POLICY",
    "mj_ray",
    "sync_tensorboard",
}
"""Names of other programs and libraries that the documentation mentions, but no code of ours."""

FOLDERS = ("src", "tests", "examples", "scripts", "benchmarks", "docs", "zoo")
"""Folders whose files the documentation may name; a path that begins with one must exist."""

FENCE = re.compile(
    r"^ *```(?:\{code-cell\} )?(\w*)\n(.*?)^ *```", re.MULTILINE | re.DOTALL
)
SPAN = re.compile(r"(?<!`)(`+)(?!`)(.+?)(?<!`)\1(?!`)", re.DOTALL)
WORD = re.compile(r"(?<![\w./<>{*-])[A-Za-z_][\w./-]*(?![\w<>{*])")


def documents():
    """Return the texts of the documentation by path; lab notes name what is gone, so not them."""
    pages = {"README.md": (ROOT / "README.md").read_text(encoding="utf-8")}
    pages |= files("docs", suffix=".md")
    return {path: text for path, text in pages.items() if "lab-notes" not in path}


def words_in(tree):
    """Yield the names in a syntax tree, and the words of its strings but those of docstrings."""
    nodes = [tree]
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            continue
        for value in vars(node).values():
            if isinstance(value, str):
                yield from re.findall(r"\w+", value)
            elif isinstance(value, list):
                nodes += [part for part in value if isinstance(part, ast.AST)]
            elif isinstance(value, ast.AST):
                nodes.append(value)


@cache
def known_words():
    """Return every name in the code, and every word in its strings; docstrings do not count."""
    words = set(FOREIGN)
    for path, text in files(
        "src", "tests", "examples", "scripts", "benchmarks"
    ).items():
        if path != "tests/test_docs.py":
            words.update(words_in(ast.parse(text)))
    for text in files("examples", "src", suffix=".toml").values():
        words.update(re.findall(r"\w+", text))
    words.update(re.findall(r"\w+", (ROOT / "Makefile").read_text(encoding="utf-8")))
    return words


@cache
def known_files():
    """Return the paths of all files that the documentation may name."""
    every = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*")]
    return {"/" + path.relative_to(ROOT).as_posix() for path in every}


def spans(text):
    """Yield what stands in backticks in a paragraph."""
    for match in SPAN.finditer(FENCE.sub("", text)):
        yield " ".join(match[2].split())


def blocks(text):
    """Yield the blocks of code, with continued lines joined."""
    for match in FENCE.finditer(text):
        yield match[2].replace("\\\n", " ")


def unknown_module(name):
    """Return whether a name that begins with ``knowarm.`` leads to no module or no known name."""
    module = name
    while module not in names():
        module = module.rpartition(".")[0]
    return (
        not set(name.removeprefix(module).strip(".").split(".")) - {""} <= known_words()
    )


def unknown_identifiers(span):
    """Yield the words of a span that look like code and occur nowhere in the code."""
    for word in (match.rstrip("./-") for match in WORD.findall(span)):
        if word.endswith(".py") or ("/" in word and word.split("/")[0] in FOLDERS):
            if not any(path.endswith("/" + word) for path in known_files()):
                yield word
        elif word.startswith("knowarm."):
            if unknown_module(word):
                yield word
        elif word.startswith("benchmarks."):
            if not (ROOT / f"{word.replace('.', '/')}.py").is_file():
                yield word
        elif not re.search(r"[/-]|\.(csv|json|log|obj|png|toml|ttl|xml)$", word):
            for part in word.split("."):
                looks_like_code = "_" in part.strip("_") or re.match(
                    r"[A-Z]\w*[a-z0-9][A-Z]", part
                )
                if looks_like_code and part not in known_words():
                    yield word


def unknown_options(command):
    """Yield the options of a command line that are no field of any config or command."""
    for option in re.findall(r"(?<![\w-])--([a-z][\w.-]*)", command):
        for part in option.replace("-", "_").split("."):
            if not {part, part.removeprefix("no_")} & {
                *known_words(),
                "help",
                "help_all",
            }:
                yield f"--{option}"


def unknown_command(command):
    """Return whether ``knowarm NAME [NAME]`` names a command, or one of a group, that is none."""
    name, *rest = [*command.split()[1:], ""]
    if not re.fullmatch(r"[a-z][a-z-]*", name):
        return False
    if name not in {**COMMANDS, **DOORS}:
        return True
    group = find_command(name)
    is_name = re.fullmatch(r"[a-z][a-z-]*", rest[0])
    return isinstance(group, Mapping) and bool(is_name) and rest[0] not in group


def command_lines(text):
    """Yield the command lines that begin with ``knowarm``, in backticks or in a block."""
    yield from (span for span in spans(text) if re.match(r"knowarm [a-z-]", span))
    for block in blocks(text):
        for line in block.splitlines():
            if found := re.match(r" *(?:\$ )?(knowarm [a-z-].*)", line):
                yield found[1].partition(" #")[0]


def assert_nothing_unknown(find):
    """Apply a function to every page; fail with what it yields, by page."""
    offenders = defaultdict(set)
    for path, text in documents().items():
        offenders[path].update(find(text))
    lines = [
        f"{path}: {name}" for path, found in offenders.items() for name in sorted(found)
    ]
    assert not lines, "\n".join([f"{len(lines)} offenders:", *lines])


def test_identifiers_in_backticks_exist():
    assert_nothing_unknown(
        lambda text: (w for s in spans(text) for w in unknown_identifiers(s))
    )


def test_names_of_the_package_in_examples_exist():
    assert_nothing_unknown(
        lambda text: (
            name
            for block in blocks(text)
            for name in re.findall(r"(?<![\w./])knowarm\.[\w.]*\w", block)
            if not name.endswith((".py", ".toml")) and unknown_module(name)
        )
    )


def test_commands_exist():
    assert_nothing_unknown(lambda text: filter(unknown_command, command_lines(text)))


def test_options_exist():
    def find(text):
        lone = (span for span in spans(text) if span.startswith("--"))
        return (
            o for line in [*lone, *command_lines(text)] for o in unknown_options(line)
        )

    assert_nothing_unknown(find)


@pytest.mark.parametrize(
    "span",
    [
        "draw_no_pictures",
        "NoSuchEnv(1)",
        "EnvConfig.no_such_field",
        "knowarm.no_such",
        "gone.py",
    ],
)
def test_an_identifier_that_does_not_exist_is_found(span):
    assert list(unknown_identifiers(span)) != []


def test_identifiers_that_exist_are_not_found():
    for span in (
        "knowarm.learn.losses.advantages",
        "learn/ppo.py",
        "gae_lambda=.9",
        "mug",
    ):
        assert list(unknown_identifiers(span)) == []


def test_a_command_or_option_that_does_not_exist_is_found():
    assert unknown_command("knowarm no-such")
    assert unknown_command("knowarm study no-such")
    assert not unknown_command("knowarm train irb120-full-fast")
    assert list(unknown_options("knowarm train --env.no-such-field")) == [
        "--env.no-such-field"
    ]
    assert list(unknown_options("knowarm train --algorithm.gamma .9 --resume")) == []


def anchors(text):
    """Return the anchors of a page's headings."""
    headings = re.findall(r"^#+ +(.*)$", FENCE.sub("", text), re.MULTILINE)
    words = [re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings]
    return {each.strip().replace(" ", "-") for each in words}


def broken_links(path, text):
    """Yield the links of a page to files or headings that do not exist."""
    for target in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", text)):
        if re.match(r"\w+:", target):
            continue
        file, _, anchor = target.partition("#")
        where = (ROOT / path).parent / file
        if not where.exists():
            yield target
            continue
        headings = anchors(
            where.read_text(encoding="utf-8") if file and anchor else text
        )
        if anchor not in {"", *headings}:
            yield target


def test_links_lead_somewhere():
    pages = documents() | files("docs", suffix=".md")
    lines = [
        f"{path}: {link}"
        for path, text in pages.items()
        for link in broken_links(path, text)
    ]
    assert not lines, "\n".join([f"{len(lines)} offenders:", *lines])


def hidden_lines(text):
    """Return the lines that MyST takes for comments, and leaves out of the page."""
    return [line for line in FENCE.sub("", text).splitlines() if line.startswith("%")]


def test_no_line_is_left_out_of_a_page_as_a_comment():
    pages = documents() | files("docs", suffix=".md")
    lines = {path: hidden_lines(text) for path, text in pages.items()}
    assert not {path: found for path, found in lines.items() if found}
    assert hidden_lines("at most 80\n% success") == ["% success"]


def test_a_broken_link_is_found():
    text = "# A title\n[a](README.md) [b](none.md) [c](#a-title) [d](#none)"
    assert list(broken_links("README.md", text)) == ["none.md", "#none"]


def test_every_promise_about_security_names_tests_that_exist():
    """A row of the table without tests must say that the input is trusted like code."""
    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line.startswith("|")][2:]
    assert len(rows) > 10
    for row in rows:
        named = re.findall(r"`((?:tests/\w+/)?test_\w+\.py|tests/[\w/]+\.py)`", row)
        assert named or "code**" in row, row
        for name in named:
            assert any(
                path.match(name) for path in (ROOT / "tests").rglob("test_*.py")
            ), name


def test_result_pages_begin_with_their_answer():
    pages = files("docs/results", suffix=".md")
    table = pages.pop("docs/results/README.md")
    rows = re.findall(r"^\| .+\? \| (.{20,}) \| \[.+?\]\((.+?)\) \|$", table, re.M)
    named = {f"docs/results/{page}" for _, page in rows}
    for page, text in pages.items():
        first = re.sub(r"<!--.*?-->\n", "", text).split("\n\n")[1]
        is_answer = first.startswith("**") and not first.startswith("**Protocol")
        assert is_answer, page
        assert page in named, f"no row of {page} in the table of results"
