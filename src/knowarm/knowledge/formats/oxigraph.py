"""pyoxigraph in a child process with limits: RDF/XML and JSON-LD documents, SPARQL queries.

The library ends its process where a document nests too deep or memory is exhausted, and Ctrl-C
waits for it. This file is also the program of the child, which imports nothing else of KnowArm.
"""

import json
import subprocess
import sys
from contextlib import suppress
from tempfile import TemporaryFile
from typing import IO, Any

import pyoxigraph as ox

SECONDS = 60.0
"""Time that a child has, and a second per MiB of its input."""
MEMORY, OUTPUT = 4 << 30, 2 << 30
"""Most bytes of memory (on Linux) and of output that a child may take."""
REFUSED = 3  # exit code after an exception, which is described on stderr


def run_oxigraph(source: IO[bytes], mib: float, **task: Any) -> IO[bytes]:
    """Run a task of `main` on a file in a child process; return its output.

    Raises:
        SyntaxError: the document or the query is malformed.
        ValueError: pyoxigraph refused it otherwise, or a limit was reached.
    """
    output = TemporaryFile()  # noqa: SIM115 (the caller closes it)
    try:
        done = subprocess.run(
            [sys.executable, "-P", __file__, json.dumps(task)],
            stdin=source,
            stdout=output,
            stderr=subprocess.PIPE,
            timeout=SECONDS + mib,
        )
    except subprocess.TimeoutExpired as error:
        raise ValueError(f"it takes more than {SECONDS + mib:.0f} s") from error
    if done.returncode == REFUSED:
        found = json.loads(done.stderr)
        error = (SyntaxError if found["is_syntax"] else ValueError)(found["message"])
        if isinstance(error, SyntaxError):
            error.lineno = found["line"]
        raise error
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
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    source, output = sys.stdin.buffer, sys.stdout.buffer
    if "query" not in task:
        syntax = ox.RdfFormat.from_extension(task["syntax"])
        quads = ox.parse(source, format=syntax, base_iri=task["base"])
        ox.serialize((quad.triple for quad in quads), output, ox.RdfFormat.N_TRIPLES)
        return
    store = ox.Store()
    store.load(source, ox.RdfFormat.N_TRIPLES)
    result = store.query(task["query"], prefixes=task["prefixes"])
    is_graph = isinstance(result, ox.QueryTriples)
    result.serialize(output, ox.RdfFormat.N_TRIPLES if is_graph else ox.QueryResultsFormat.JSON)


if __name__ == "__main__":
    try:
        main(json.loads(sys.argv[1]))
        sys.stdout.flush()
    except Exception as error:
        is_syntax, line = isinstance(error, SyntaxError), getattr(error, "lineno", None)
        message = str(error.msg) if isinstance(error, SyntaxError) else str(error)
        shown = {"is_syntax": is_syntax, "line": line, "message": message[:2000]}
        print(json.dumps(shown), file=sys.stderr)
        sys.exit(REFUSED)
