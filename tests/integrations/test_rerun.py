"""Recordings for Rerun, read back by Rerun."""

import pytest

from knowarm.cli.main import main

pytest.importorskip("rerun")


@pytest.mark.slow(8)
def test_an_episode_is_recorded(tmp_path, capsys):
    path = tmp_path / "episode.rrd"
    assert main(["view", "irb120", "--episodes", "2", "--rrd", str(path)]) == 0
    assert str(path) in capsys.readouterr().out
    entities = {str(chunk.entity_path) for chunk in chunks(path)}
    assert sum(name.startswith("/joints/") for name in entities) == 6
    assert entities >= {"/camera/policy", "/camera/large", "/distance", "/angle", "/goal"}
    rows = sum(chunk.num_rows for chunk in chunks(path) if str(chunk.entity_path) == "/distance")
    assert rows > 20


def chunks(path):
    """Read the chunks of a recording."""
    from rerun.chunk import RrdReader

    return list(RrdReader(str(path)).stream().to_chunks())


def test_another_suffix_is_refused(tmp_path, capsys):
    assert main(["view", "irb120", "--rrd", str(tmp_path / "episode.mp4")]) == 2
    assert ".rrd" in capsys.readouterr().err
