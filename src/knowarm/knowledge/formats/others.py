"""Formats of graphs that are not read, by name, with the way to one that is."""

import re
from pathlib import Path
from typing import NamedTuple

from knowarm.errors import UserError
from knowarm.knowledge.formats.files import python, quoted


class Other(NamedTuple):
    """A format that is not read."""

    suffixes: tuple[str, ...]
    way: str = (
        ""  # What to do; <file> and <name>, the file without suffix, are in quotes
    )
    code: str = ""  # Or Python that converts it from <file> to <made>
    made: str = ""  # Suffix that is added to the name of what the code writes
    begins: str = r"(?!)"  # Regular expression of how the content begins


_EXPORT = 'CALL apoc.export.csv.all("graph.csv", {}), and give that file.'
_XML = r"(?>\s+|<\?.*?\?>|<!--.*?-->)*+"

OTHERS = {
    "HDT": Other((".hdt",), "Convert it: hdt2rdf <file> <name>.nt", begins=r"\$HDT"),
    "TriX": Other(
        (".trix",),
        code='import rdflib; graph = rdflib.Dataset(); graph.parse(<file>, format="trix"); '
        'graph.serialize(<made>, format="nquads")',
        made=".nq",
        begins=rf"{_XML}<TriX\b",
    ),
    "XML of SPARQL answers": Other(
        (".srx",),
        "Ask for triples with CONSTRUCT, and save them as Turtle.",
        begins=rf"{_XML}<sparql\b",
    ),
    "Cypher": Other(
        (".cypher", ".cql", ".cyp"),
        f"Run it in Neo4j and export the graph: {_EXPORT}",
        begins=r"(?i:(?:create|merge|match)\s*\(|create\s+(?:constraint|index)|:begin\b|load csv)",
    ),
    "a dump of Neo4j": Other(
        (".dump", ".backup"), f"Load it into Neo4j and export the graph: {_EXPORT}"
    ),
    "YAML": Other(
        (".yaml", ".yml"),
        code='import json, yaml; json.dump(yaml.safe_load(open(<file>)), open(<made>, "w"))',
        made=".json",
        begins=r"---[ \t]*\n",
    ),
    "Prolog": Other(
        (".pl", ".pro", ".prolog", ".lp", ".dl"),
        'Convert those of two arguments: tr -d "\'" < <file> | sed -nE '
        r"'s/^ *([A-Za-z_0-9]+)\( *([^,()]+), *([^,()]+)\).*/\2,\1,\3/p' > <name>.csv",
        begins=r"(?::-[^\n]*|[a-z]\w*\([^()\n]*,[^()\n]*\)[ \t]*\.?[ \t]*(?:%[^\n]*)?)(?:\n|\Z)",
    ),
    "a spreadsheet": Other(
        (".xlsx", ".xls", ".ods"),
        code="import pandas; pandas.read_excel(<file>).to_csv(<made>, index=False)",
        made=".csv",
    ),
    "Parquet": Other(
        (".parquet",),
        code="import pyarrow.csv, pyarrow.parquet; "
        "pyarrow.csv.write_csv(pyarrow.parquet.read_table(<file>), <made>)",
        made=".csv",
        begins="PAR1",
    ),
    "a database of SQLite": Other(
        (".sqlite", ".sqlite3", ".db"),
        "Select the triples: sqlite3 -header -csv <file> "
        "'SELECT head, relation, tail FROM triples' > <name>.csv",
        begins="SQLite format 3",
    ),
    "DOT of Graphviz": Other(
        (".dot", ".gv"),
        code="import networkx; "
        "networkx.write_graphml(networkx.nx_pydot.read_dot(<file>), <made>)",
        made=".graphml",
        begins=r"(?:strict\s+)?(?:di)?graph\b[^\n\[]*\{",
    ),
    "pickle": Other(
        (".pkl", ".pickle", ".gpickle"),
        "A pickle may run code. Write the graph in another format where it was made.",
    ),
    "PDDL": Other((".pddl", ".bddl"), "Write its facts as lines such as mug,on,table."),
}
"""Formats by what they are called."""


def refuse_others(path: Path, suffix: str, content: str) -> None:
    """Refuse a file of one of `OTHERS`, by its suffix or content."""
    for name, other in OTHERS.items():
        is_it = re.match(other.begins, content, re.DOTALL) is not None
        if suffix in other.suffixes or is_it:
            way = _way(path, other)
            raise UserError(f"{path}: {name} is not read. {way}")


def _way(path: Path, other: Other) -> str:
    """Return what to do with a file."""
    if other.code:
        made = f"{path}{other.made}"
        return f"Convert it: {python(other.code, path, made)}"
    name = quoted(path.with_suffix(""))
    return other.way.replace("<file>", quoted(path)).replace("<name>", name)
