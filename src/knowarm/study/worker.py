"""Worker of a study: trains and evaluates one run, in a process of its own.

``python -m knowarm.study.worker OUT EXPERIMENT SEED`` is what the local executor starts.
"""

import os
import signal
import sys
import threading
import time
import traceback
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import psutil

from knowarm.errors import UserError
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.run import train
from knowarm.experiment.run_folder import RunExistsError, RunFolder
from knowarm.experiment.run_lock import FolderInUseError, StopRequest, lock_folder
from knowarm.reading import write_json
from knowarm.study.config import read_study
from knowarm.study.executor import TIMEOUT_S, RunKey, folder_of
from knowarm.study.status import FAILURE, is_trained, missing_evaluations, pause_step

STOP = "stop"  # file in a study's folder: all workers save a checkpoint and end
# Start of the last line that a worker prints, followed by its time.
WORKED = "worked for"


def work(out: Path, key: RunKey) -> None:
    """Train and evaluate one run as far as it is not, and record an error in its folder."""
    path = folder_of(out, key)
    try:
        study = read_study(out)
        config = study.run(*key)
        folder = RunFolder(path)
        stop = out / STOP
        is_started = folder.config_path.exists()
        if not (is_started and is_trained(folder, config)):
            with StopRequest() as is_asked:

                def should_stop() -> bool:
                    return is_asked() or stop.exists()

                train_run = partial(
                    train,
                    config,
                    out,
                    should_stop=should_stop,
                    until_step=pause_step(out),
                )
                try:
                    run = train_run(resume=is_started)
                except RunExistsError:
                    # Begun meanwhile by the worker of a driver that was killed.
                    run = train_run(resume=True)
            if run.result.reason == "stopped":
                return
        with lock_folder(path, remedy="Wait until it ends."):
            for evaluation in missing_evaluations(folder, study.evaluations):
                if stop.exists():
                    return
                evaluate(path, config=evaluation)
    except FolderInUseError:
        print("another process works on this run", file=sys.stderr)
    except Exception as error:
        reason = str(error)
        if not isinstance(error, UserError):
            reason = " ".join(f"{type(error).__name__}: {error}".split())
        record_failure(path, reason, traceback.format_exc())
        print(f"failed: {reason}", file=sys.stderr)


def record_failure(path: Path, reason: str, details: str = "") -> None:
    """Write why a run failed into its folder, from which it counts as failed."""
    when = datetime.now(UTC).isoformat(timespec="seconds")
    write_json(path / FAILURE, {"reason": reason, "time": when, "traceback": details})


def main() -> None:
    """Work on the run that the arguments name, until the parent process exits."""
    out, experiment, seed = sys.argv[1:]
    threading.Thread(target=_end_with_parent, daemon=True).start()
    work(Path(out), (experiment, int(seed)))
    print(
        f"{WORKED} {time.time() - psutil.Process().create_time():.1f} s",
        file=sys.stderr,
    )


def _end_with_parent() -> None:
    """Ask this process to save and end once the other end of its input is closed."""
    os.read(0, 1)
    _request_stop()
    threading.Event().wait(TIMEOUT_S)
    os._exit(1)


def _request_stop() -> None:
    """Send this process SIGTERM; on Windows `os.kill` would end it without its handler."""
    if os.name == "nt":
        signal.raise_signal(signal.SIGTERM)
    else:
        os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    main()
