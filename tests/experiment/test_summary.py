import numpy as np
import pyarrow.parquet as pq
import pytest

from knowarm.errors import UserError
from knowarm.experiment.summary import (
    EPISODE_COLUMNS,
    read_film,
    read_table,
    step_columns,
    write_film,
    write_table,
)


@pytest.mark.parametrize("described", [EPISODE_COLUMNS, step_columns(7)])
def test_every_column_carries_its_meaning_and_unit(tmp_path, described):
    columns = {
        name: np.zeros(2) for name, (kind, _) in described.items() if kind != "string"
    }
    columns |= {
        name: np.array(["", ""])
        for name, (kind, _) in described.items()
        if kind == "string"
    }
    write_table(tmp_path / "t.parquet", columns, described)
    for field in pq.read_schema(tmp_path / "t.parquet"):
        meaning = field.metadata[b"meaning"].decode()
        assert meaning == described[field.name][1]
        for suffix, unit in (("_m", "[m]"), ("_deg", "[deg]"), ("_rad", "[rad]")):
            assert not field.name.endswith(suffix) or unit in meaning


def test_what_cannot_be_read_is_named(tmp_path):
    with pytest.raises(UserError, match="Cannot read"):
        read_table(tmp_path / "missing.parquet")
    (tmp_path / "broken.parquet").write_bytes(b"PAR1")
    with pytest.raises(UserError, match=r"broken\.parquet"):
        read_table(tmp_path / "broken.parquet")


@pytest.mark.parametrize(
    ("count", "still"),
    [(50, []), (50, [20]), (50, [49]), (50, [1, 2, 3, 48, 49]), (1, [])],
)
def test_every_image_comes_back(tmp_path, count, still):
    frames = np.random.default_rng(0).integers(
        0, 256, (count, 16, 16, 3), dtype=np.uint8
    )
    for number in still:  # the arm stood still: this image equals the one before
        frames[number] = frames[number - 1]
    write_film(tmp_path / "films" / "0.webp", frames)
    np.testing.assert_array_equal(read_film(tmp_path / "films" / "0.webp"), frames)


def test_what_is_no_film_is_refused(tmp_path):
    (tmp_path / "0.webp").write_bytes(b"no image")
    with pytest.raises(UserError, match="Evaluate the run again"):
        read_film(tmp_path / "0.webp")
