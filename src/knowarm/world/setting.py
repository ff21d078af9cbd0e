"""What follows from an environment's config: its scene, facets and questions."""

from knowarm.questions import QuestionTable
from knowarm.world.config import EnvConfig
from knowarm.world.scene.scene import Scene, find_targets, load_scene
from knowarm.world.tasks.sampling import Setting, list_facets


def scene_of(config: EnvConfig) -> Scene:
    """Load the scene of a config."""
    return load_scene(
        config.robot, config.targets, config.randomization.distractors, config.task.area
    )


def setting_of(config: EnvConfig) -> Setting:
    """Return what the task of a config draws episodes from."""
    return Setting(scene_of(config), config.colours, config.held_out)


def facets_of(config: EnvConfig) -> tuple[tuple[str, str], ...]:
    """List the (object, colour) pairs that a config shows; objects in config order."""
    return list_facets(find_targets(config.targets), config.colours)


def questions_of(config: EnvConfig) -> QuestionTable | None:
    """Return the questions of a config's task; None if its episodes have none."""
    return config.task.questions(facets_of(config))
