"""Settings of the fork server, the parent of all child processes; it imports this module.

Only the fork server does: importing it changes how the process handles a signal.
"""

import signal

# When a terminal closes or Ctrl-C is pressed, every process in it receives a signal. The training
# process saves and stops its children; they must not end before it has asked for their states.
for number in (signal.SIGHUP, signal.SIGINT):
    signal.signal(number, signal.SIG_IGN)

from numba.core.registry import cpu_target  # noqa: E402 (takes seconds, in which signals may come)

# Otherwise each child process does what a process does before its first compiled function.
cpu_target.typing_context.refresh()
cpu_target.target_context.refresh()
