"""Fence: parsers written in C or Rust, run on a stranger's file in a process with limits.

A file that nests deep enough overflows the stack of such a parser, which ends its process; another
one lets it compute for ever. In a process of its own, both are an error in one line.
"""

import math
import signal
import subprocess
import sys

SECONDS = 60.0
"""Processor time of a parser, and of any further megabyte of its input [s]."""
WAIT = 5.0
"""Longest time that it takes on a machine that others use, in processor times."""
MEMORY = 2 * 2**30
"""Address space of a parser [bytes], beside 200 times the size of its input."""
LIMITS = """
import sys
data = sys.stdin.buffer.read()
try:
    import resource
except ImportError:  # Windows
    resource = None
if resource:
    for kind, most in ((resource.RLIMIT_AS, {memory}), (resource.RLIMIT_CPU, {seconds}),
                       (resource.RLIMIT_CORE, 0)):
        _, hard = resource.getrlimit(kind)
        resource.setrlimit(kind, (most if hard < 0 else min(most, hard), hard))
try:
    sys.stdout.buffer.write(parse(data))
except MemoryError:
    sys.exit(2)
except Exception as error:
    sys.stderr.write(str(error) or type(error).__name__)
    sys.exit(1)
"""


class ParserError(ValueError):
    """A parser does not read its input; the message is the parser's own."""


def fenced(parser: str, data: bytes) -> bytes:
    """Run a parser on data in a process with limits, and return what it makes of them.

    Args:
        parser: source that defines ``parse``, from bytes to bytes; it imports no KnowArm.
        data: content of the file.

    Raises:
        ParserError: the parser raised any exception.
        ValueError: it crossed a limit.
    """
    megabytes = len(data) / 2**20
    seconds = SECONDS * (1 + megabytes)
    limits = LIMITS.format(memory=MEMORY + 200 * len(data), seconds=math.ceil(seconds))
    command = [sys.executable, "-P", "-c", parser + limits]
    try:
        done = subprocess.run(
            command, input=data, capture_output=True, timeout=WAIT * seconds
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"its parser takes {WAIT * seconds:.0f} s") from None
    if done.returncode < 0 or done.returncode > 1:
        reason = "nests too deep, or needs more memory or time than its size allows"
        raise ValueError(f"it {reason} ({_name(done.returncode)})")
    if done.returncode:
        raise ParserError(done.stderr.decode(errors="replace"))
    return done.stdout


def _name(code: int) -> str:
    """Name the signal that ended a process."""
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"exit code {code}"
