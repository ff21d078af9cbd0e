"""Settings of the fork server, the parent of all child processes; it imports this module.

Only the fork server does: importing it changes how the process handles a signal.
"""

import signal

from numba.core.registry import cpu_target

# When a terminal closes, the kernel sends SIGHUP to every process in it. The training process saves
# and stops its children; they must not end before it has asked for their states.
signal.signal(signal.SIGHUP, signal.SIG_IGN)

# Otherwise each child process does what a process does before its first compiled function.
cpu_target.typing_context.refresh()
cpu_target.target_context.refresh()
