"""Triples as people and language models write them: read as triples, or refused in one line."""

import csv

import pytest

from knowarm.errors import DataWarning, UserError
from knowarm.knowledge import read_graph

TRIPLES = (
    ("mug", "usedFor", "drinking"),
    ("wine glass", "contains", "red wine"),
    ("kettle", "usedFor", "boiling"),
)


def lines(pattern):
    rows = []
    for number, (h, r, t) in enumerate(TRIPLES, 1):
        rows.append(pattern.format(n=number, h=h, r=r, t=t) + "\n")
    return "".join(rows)


LINES = [
    "({h}, {r}, {t})",
    "({h},{r},{t}),",
    '("{h}", "{r}", "{t}")',
    "('{h}', '{r}', '{t}'),",
    "({h}; {r}; {t})",
    "({h} | {r} | {t}).",
    "{n}. ({h}, {r}, {t})",
    "- ({h}, {r}, {t})",
    "<{h}, {r}, {t}>",
    "<{h}> <{r}> <{t}> .",
    "<{h}>, <{r}>, <{t}>",
    "[{h}, {r}, {t}]",
    "['{h}', '{r}', '{t}'],",
    '["{h}","{r}","{t}"]',
    "{{{h}, {r}, {t}}}",
    "- {h}, {r}, {t}",
    "- {h}, {r}, {t}.",
    "- {h} | {r} | {t}",
    "* {h} | {r} | {t}",
    "• {h}; {r}; {t}",
    "- {h} -> {r} -> {t}",
    "{n}. {h} -> {r} -> {t}",
    "{n}) {h}, {r}, {t}",
    "{n}. {h}\t{r}\t{t}",
    "{h} → {r} → {t}",
    "{h} --{r}--> {t}",
    "{h} -[{r}]-> {t}",
    "({h})-[:{r}]->({t})",
    "({h} -> {r} -> {t})",
    "- **{h}** | {r} | {t}",
    "- **{h}** → *{r}* → `{t}`",
    "- `({h}, {r}, {t})`",
    "Subject: {h}, Predicate: {r}, Object: {t}",
    "(subject: {h}, relation: {r}, object: {t})",
    "| {h} | {r} | {t} |",
    "Triple {n}: ({h}, {r}, {t})",
    "T{n}. ({h}, {r}, {t})",
    "⟨{h}, {r}, {t}⟩",
    "✅ ({h}, {r}, {t})",
    "➤ {h}, {r}, {t}",
    "> ({h}, {r}, {t})",
    "> - {h}, {r}, {t}",
    "- [ ] {h}, {r}, {t}",
    "a) {h}, {r}, {t}",
    "Subject={h}; Predicate={r}; Object={t}",
    "head: {h} | relation: {r} | tail: {t}",
    "{{head: {h}, relation: {r}, tail: {t}}}",
    "{{'subject': '{h}', 'predicate': '{r}', 'object': '{t}'}},",
    '{{"head": "{h}", "relation": "{r}", "tail": "{t}"}}',
]
"""One triple per line."""

TABLE = "| head | relation | tail |\n|---|---|---|\n" + lines("| {h} | {r} | {t} |")
BOXES = "+---+---+---+\n"
TEXTS = {
    "one line": "[('mug', 'usedFor', 'drinking'), ('wine glass', 'contains', 'red wine'), "
    "('kettle', 'usedFor', 'boiling')]",
    "one line without quotes": lines("({h}, {r}, {t})").replace("\n", " "),
    "a list of Python": "triples = [\n" + lines("    ('{h}', '{r}', '{t}'),") + "]\n",
    "a header": "(head, relation, tail)\n" + lines("({h}, {r}, {t})"),
    "a plain header": "head, relation, tail\n" + lines("({h}, {r}, {t})"),
    "Markdown": "| Head | Relation | Tail |\n|---|:---:|---:|\n" + lines("| {h} | {r} | {t} |"),
    "Markdown in another order": "| Object | Subject | Predicate |\n| --- | --- | --- |\n"
    + lines("| {t} | {h} | {r} |"),
    "Markdown without ends": "head | relation | tail\n--- | --- | ---\n" + lines("{h} | {r} | {t}"),
    "two tables": f"{TABLE}\n{TABLE}",
    "boxes": BOXES + "| head | relation | tail |\n" + BOXES + lines("| {h} | {r} | {t} |") + BOXES,
    "a code block": f"```\n{lines('({h}, {r}, {t})')}```\n",
    "a code block of CSV": f"```csv\nhead,relation,tail\n{lines('{h},{r},{t}')}```\n",
    "windows": lines("({h}, {r}, {t})").replace("\n", "\r\n"),
}  # fmt: skip

PROSE = {
    "before": "Here are some triples about things at home:\n\n{}",
    "before, with commas": "Sure, here they are, friend\n{}",
    "around": "# Triples\n\nHere they are.\n\n{}\nLet me know, please, if you need more!\n",
    "around a code block": "Sure!\n\n```text\n{}```\n\nI hope this helps.\n",
}


def written(path, text):
    path.write_text(text, "utf-8", newline="")
    return path


@pytest.mark.filterwarnings("error::knowarm.errors.DataWarning")
@pytest.mark.parametrize("name", ["a.txt", "a.csv", "a.md", "answer"])
@pytest.mark.parametrize("pattern", LINES)
def test_lines_that_are_set_off_are_triples(tmp_path, pattern, name):
    assert set(read_graph(written(tmp_path / name, lines(pattern)))) == set(TRIPLES)


@pytest.mark.filterwarnings("error::knowarm.errors.DataWarning")
@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
@pytest.mark.parametrize("name", ["a.txt", "a.md", "a.tsv"])
def test_texts_of_triples(tmp_path, text, name):
    assert set(read_graph(written(tmp_path / name, text))) == set(TRIPLES)


@pytest.mark.parametrize("prose", PROSE.values(), ids=PROSE)
@pytest.mark.parametrize(
    "pattern", ["({h}, {r}, {t})", "- {h} | {r} | {t}", "| {h} | {r} | {t} |"]
)
def test_sentences_around_triples_are_left_out_with_a_line(tmp_path, pattern, prose):
    path = written(tmp_path / "a.md", prose.format(lines(pattern)))
    with pytest.warns(
        DataWarning, match="left out are .* lines without a triple, such as line 1"
    ):
        assert set(read_graph(path)) == set(TRIPLES)


def test_a_column_of_confidence_in_markdown(tmp_path):
    text = "| head | relation | tail | confidence |\n|---|---|---|---|\n| mug | on | desk | 0.5 |\n"
    assert read_graph(written(tmp_path / "a.md", text)).confidence == {
        ("mug", "on", "desk"): 0.5
    }


MARKS = [
    "({h}, {r}, {t}): 0.9",
    "({h}, {r}, {t})  # because",
    "(({h}), ({r}), ({t}))",
    "NOT ({h}, {r}, {t})",
    "$({h}, {r}, {t})$",
    "-{h},{r},{t}",
    "*{h}*, *{r}*, *{t}*",
    "_{h}_ | _{r}_ | _{t}_",
    "<triple>{h}|{r}|{t}</triple>",
]
"""Brackets and marks that are not understood."""


@pytest.mark.parametrize("pattern", MARKS)
@pytest.mark.parametrize("name", ["a.txt", "a.csv", "a.tsv"])
def test_marks_never_become_parts_of_names(tmp_path, pattern, name):
    with pytest.raises(UserError, match="which would become part of names") as error:
        read_graph(written(tmp_path / name, lines(pattern)))
    assert "\n" not in str(error.value)


def test_items_without_brackets_are_prose_where_triples_have_them(tmp_path):
    text = (
        "1. **Mug**\n   - (mug, usedFor, drinking)\n2. **Kettle**, as used at home, for tea\n"
        "   - (kettle, usedFor, boiling)\n"
    )
    with pytest.warns(DataWarning, match="left out are 2 lines without a triple"):
        graph = read_graph(written(tmp_path / "a.md", text))
    assert set(graph) == {TRIPLES[0], TRIPLES[2]}


REFUSED = [
    ("(mug, usedFor, drinking)\n(bottle, contains, wat", "line 2: a bracket is not closed"),
    ("(mug, drinking)\n(bottle, water)\n", "line 1: has 2 columns, but a row has 3"),
    ("(mug, usedFor, drinking, 0.9)\n", "line 1: has 4 columns, .*head,relation,tail,weight"),
    ("- mug, usedFor, drinking, tea\n", "line 1: has 4 columns"),
    ("| Object | Use | Material |\n|---|---|---|\n| mug | drinking | clay |\n",
     "line 1: Object, Use, Material name columns, .* Name them head, relation, tail"),
    (f"{TABLE}\n| a | b | c |\n|---|---|---|\n", "line 7: another table begins"),
    ("Sure!\n```turtle\n@prefix : <http://e.org/> .\n```\n", "line 2: a code block in turtle"),
    ("Sure!\n```json\n[]\n```\n", "line 2: a code block in json"),
    ("A mug is used for drinking.\nA bottle holds water, often.\n", "line 1: has 1 column"),
    ("mug: usedFor: drinking\n", "line 1: has 1 column"),
    ("Subject: mug\nPredicate: usedFor\nObject: drinking\n", "line 1: has 1 column"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), REFUSED)
def test_what_is_no_triple_is_refused_in_one_true_line(tmp_path, text, message):
    with pytest.raises(UserError, match=message) as error:
        read_graph(written(tmp_path / "a.txt", text))
    assert "\n" not in str(error.value)


def test_the_remedy_for_a_fourth_cell_works_when_it_is_typed(tmp_path):
    text = "head,relation,tail,weight\n(mug, usedFor, drinking, 0.9)\n"
    with pytest.warns(DataWarning, match="not read: weight"):
        assert list(read_graph(written(tmp_path / "a.txt", text))) == [TRIPLES[0]]


TABLES = {
    "names with brackets": "head,relation,tail\nmug (cup),on,table\n(small) bowl,on,table\n",
    "names with dashes": "head,relation,tail\n-ive,on,table\n1. FC Bayern,isA,club\n",
    "names of one form": "(R)-mug,on,table\n(S)-mug,on,table\n",
    "open brackets": "mug (blue,on,table\nbowl(red,on,table\n",
    "arrows in names": "a->b,on,a->c\nb->c,on,c->d\n",
    "paths": "/c/en/mug,/r/IsA,/c/en/cup\n/c/en/pan,/r/IsA,/c/en/pot\n",
    "blank nodes": "_:a,on,_:b\n_:c,on,_:d\n",
    "arrows inside": "mug,moves -> to,table\nbowl,moves -> to,table\n",
    "numbers inside": "mug,on,1: table\nbowl,on,1: table\nbowl,(in) - x,- y\n",
    "bars": "mug|on|table\nbowl|on|table\n",
    "quotes": '"(mug)","on","table"\n"<bowl>","on","table"\n',
}


@pytest.mark.filterwarnings("error::knowarm.errors.DataWarning")
@pytest.mark.parametrize("text", TABLES.values(), ids=TABLES)
def test_a_table_stays_a_table(tmp_path, text):
    separator = "|" if "|" in text else ","
    rows = set(map(tuple, csv.reader(text.splitlines(), delimiter=separator)))
    rows.discard(("head", "relation", "tail"))
    assert set(read_graph(written(tmp_path / "a.csv", text))) == rows
