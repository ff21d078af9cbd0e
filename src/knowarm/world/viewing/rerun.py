"""Recordings of played episodes for the Rerun viewer (``.rrd``)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from knowarm.arrays import Floats32
from knowarm.errors import UserError, packages_of
from knowarm.reading import replacing
from knowarm.world.viewing.record import FRAMES_PER_S, Frame


def check_rrd(path: Path) -> Any:
    """Return Rerun's package; raise a `UserError` unless it can write a recording to a file."""
    with packages_of("rerun", "A recording for Rerun"):
        import rerun
    if path.suffix != ".rrd":
        raise UserError(f"A recording for Rerun is an .rrd file, got {path.name!r}.")
    return rerun


def write_rrd(
    path: Path,
    episodes: Sequence[Sequence[Frame]],
    joints: Sequence[str],
    knowledge: Sequence[Mapping[str, Floats32]] = (),
) -> None:
    """Write images, joint angles, goal, distance and angle of every step.

    Timelines are ``episode``, ``step`` and the ``time`` of the real robot; entities are
    ``camera/policy``, ``camera/large``, ``joints/NAME`` [rad], ``distance`` [m], ``angle`` [deg]
    and ``goal``. ``knowledge`` holds further arrays by name, per episode: a vector, or a map of the
    image, as ``knowledge`` and ``recognition``.
    """
    rerun = check_rrd(path)
    with replacing(path) as temporary:
        recording = rerun.RecordingStream("knowarm")
        recording.save(str(temporary))
        time = 0
        for number, frames in enumerate(episodes):
            recording.set_time("episode", sequence=number)
            recording.set_time("step", sequence=0)
            recording.set_time("time", duration=time / FRAMES_PER_S)
            recording.log("goal", rerun.TextLog(frames[0].goal or "reach"))
            arrays = knowledge[number] if knowledge else {}
            for name, values in arrays.items():
                kind = rerun.BarChart if values.ndim == 1 else rerun.Tensor
                recording.log(name, kind(values))
            for frame in frames:
                recording.set_time("step", sequence=frame.step)
                recording.set_time("time", duration=time / FRAMES_PER_S)
                time += 1
                recording.log("camera/policy", rerun.Image(frame.policy))
                large = rerun.Image(frame.large).compress(jpeg_quality=90)
                recording.log("camera/large", large)
                recording.log("distance", rerun.Scalars(frame.distance))
                recording.log("angle", rerun.Scalars(frame.angle))
                for name, value in zip(joints, frame.joints, strict=True):
                    recording.log(f"joints/{name}", rerun.Scalars(float(value)))
        recording.flush()
        recording.disconnect()
