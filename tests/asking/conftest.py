import pytest


@pytest.fixture
def small_films(monkeypatch):
    """Let environments draw the images of films in a quarter of their width and height."""
    monkeypatch.setattr("knowarm.world.envs.vector_env.RENDER_SIZE", 120)
