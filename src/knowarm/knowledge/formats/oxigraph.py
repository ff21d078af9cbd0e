"""pyoxigraph in a child process with limits: RDF/XML and JSON-LD documents, SPARQL queries.

The library ends its process where a document nests too deep or memory is exhausted, and Ctrl-C
waits for it. This file is also the program of the child, which imports nothing else of KnowArm.
"""

import errno
import json
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from tempfile import TemporaryFile
from typing import IO, Any
from xml.parsers import expat

import pyoxigraph as ox

SECONDS = 60.0
"""Time that a child has, and a second per MiB of its input."""
MEMORY, OUTPUT = 4 << 30, 2 << 30
"""Most bytes of memory (on Linux) and of output that a child may take."""
REFUSED = 3  # exit code after an exception, which is described on stderr


def run_oxigraph(write: Callable[[IO[bytes]], object], **task: Any) -> IO[bytes]:
    """Run a task of `main` on what ``write`` writes in a child process; return its output.

    Raises:
        SyntaxError: the document or the query is malformed.
        ValueError: pyoxigraph refused it otherwise, or a limit was reached.
    """
    output = TemporaryFile()  # noqa: SIM115 (the caller closes it)
    command = [sys.executable, "-P", __file__, json.dumps(task | {"memory": MEMORY})]
    with TemporaryFile() as source:
        write(source)
        limit = SECONDS + source.tell() / 2**20
        source.seek(0)
        try:
            streams: dict[str, Any] = {"stdin": source, "stdout": output, "stderr": subprocess.PIPE}
            done = subprocess.run(command, timeout=limit, **streams)
        except subprocess.TimeoutExpired as error:
            raise ValueError(f"it takes more than {limit:.0f} s") from error
    if done.returncode == REFUSED:
        found = json.loads(done.stderr)
        if "line" in found:
            raise SyntaxError(found["message"], (None, found["line"], None, None))
        raise ValueError(found["message"])
    if done.returncode:
        raise ValueError(f"it nests too deep, or needs more than {MEMORY >> 30} GiB of memory")
    output.seek(0)
    return output


def main(task: dict[str, Any]) -> None:
    """Convert a document to N-Triples, or answer a query on N-Triples."""
    with suppress(ImportError, ValueError, OSError):  # not every system has all limits
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (OUTPUT, OUTPUT))
        resource.setrlimit(resource.RLIMIT_AS, (task["memory"], task["memory"]))
    source, output = sys.stdin.buffer, sys.stdout.buffer
    if "query" not in task:
        syntax = ox.RdfFormat.from_extension(task["syntax"])
        quads = ox.parse(source, format=syntax, base_iri=task["base"])
        try:
            ox.serialize((quad.triple for quad in quads), output, ox.RdfFormat.N_TRIPLES)
        except SyntaxError as error:
            if syntax == ox.RdfFormat.RDF_XML and error.lineno is None:  # expat knows the line
                source.seek(0)
                expat.ParserCreate().ParseFile(source)
            raise
        return
    store = ox.Store()
    store.bulk_extend(ox.parse(source, ox.RdfFormat.N_TRIPLES))  # `load` renames blank nodes
    result = store.query(task["query"], prefixes=task["prefixes"])
    if isinstance(result, ox.QueryTriples):
        result.serialize(output, ox.RdfFormat.N_TRIPLES)
    else:
        result.serialize(output, ox.QueryResultsFormat.JSON)


if __name__ == "__main__":
    try:
        main(json.loads(sys.argv[1]))
        sys.stdout.flush()
    except Exception as error:
        shown: dict[str, Any] = {"message": str(error)}
        if isinstance(error, SyntaxError):
            shown = {"line": error.lineno, "message": str(error.msg)}
        if isinstance(error, expat.ExpatError):
            shown = {"line": error.lineno, "message": expat.errors.messages[error.code]}
        if isinstance(error, OSError) and error.errno == errno.EFBIG:
            shown["message"] = f"its result is larger than {OUTPUT >> 30} GiB"
        print(json.dumps(shown), file=sys.stderr)
        sys.exit(REFUSED)
