import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.experiment.film import read_film, write_film


@pytest.mark.parametrize("still", [[], [20], [49], [1, 2, 3, 48, 49]])
def test_every_image_comes_back(tmp_path, still):
    frames = np.random.default_rng(0).integers(0, 256, (50, 16, 16, 3), dtype=np.uint8)
    for number in still:  # the arm stood still: this image equals the one before
        frames[number] = frames[number - 1]
    write_film(tmp_path / "films" / "0.webp", frames)
    np.testing.assert_array_equal(read_film(tmp_path / "films" / "0.webp"), frames)


def test_one_image_is_a_film(tmp_path):
    frames = np.full((1, 8, 8, 3), 7, np.uint8)
    write_film(tmp_path / "0.webp", frames)
    np.testing.assert_array_equal(read_film(tmp_path / "0.webp"), frames)


def test_what_is_no_film_is_refused(tmp_path):
    (tmp_path / "0.webp").write_bytes(b"no image")
    with pytest.raises(UserError, match="Evaluate the run again"):
        read_film(tmp_path / "0.webp")
