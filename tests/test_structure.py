"""Structure of the source: imports, registries, random state, names and lengths of modules."""

import ast
import re
import subprocess
import sys
import tomllib
from collections import defaultdict

from knowarm.experiment.agents import AGENTS
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.world.robots import ROBOTS
from knowarm.world.tasks.asked import ASKED
from knowarm.world.tasks.asked.asked import Asking
from knowarm.world.tasks.skills import SKILLS
from knowarm.world.tasks.skills.skill import Skill
from knowarm.world.tasks.task import Task
from tests.source_tree import ROOT, dotted, edges, files, imported, modules, package

BELOW = {
    "": set(),
    "knowledge": set(),
    "world": {"knowledge"},
    "policy": set(),
    "statistics": set(),
    "learn": {"policy"},
    "perception": {"world", "policy", "learn"},
    "experiment": {"knowledge", "world", "policy", "statistics", "learn", "perception"},
    "study": {"knowledge", "world", "learn", "experiment"},
    "report": {"knowledge", "world", "policy", "statistics", "learn", "experiment"},
}
"""Packages of the core: which others each may import, beside itself and the root's modules."""

CORE = {*BELOW, "cli"}
"""All packages of the core; `cli` may import all others."""

DOORS = {
    "own_robot": CORE,
    "asking": CORE,
    "deploy": CORE | {"asking"},
    "benchmark": CORE | {"deploy"},
}
"""Packages above the core, and what each may import. No module of the core imports a door: the
command line names their commands, and imports them when they are typed."""

REGISTRIES = {
    "world/robots/": set(ROBOTS),
    "world/tasks/": {*ASKED, *SKILLS},
    "experiment/agents.py": set(AGENTS),
    "experiment/algorithms.py": set(ALGORITHMS),
    "learn/algorithms.py": set(ALGORITHMS),
}
"""Files (or folders) that own names: the registries, and the algorithms' literal tags."""

OTHER_MEANINGS = {
    "nothing": "",  # scope of knowledge
    "target": "",  # column of evaluations: the episode's object
    "full": "knowledge/",  # KnowledgeConfig.detail
    "partial": "knowledge/",
    "learned": "policy/",  # PolicyConfig.knowledge_encoder
    "wide": "experiment/run.py",  # field of PolicyConfig
    "reach": "world/tasks/",  # size of a handle
    "seen": "perception/",  # of answers and networks: what an image shows
}
"""Names of agents and tasks that mean something else in a place."""

SPECIAL_WORDS = {
    "lift": (),
    "famil": (
        "asking/",  # families of relations
        "svg.py",  # of fonts
        "knowledge/formats/",  # a shipped graph
    ),
    "purpose": (
        "seeding.py",  # of a stream of random numbers
        "world/envs/episodes.py",  # of a list of episodes
        "asking/",  # "for ..." in a sentence
        "knowledge/formats/",  # a shipped graph
    ),
}
"""Beginnings of words that only `world/tasks/` uses, and where they mean something else. Parts of
objects are no such word: what a name such as "mug.handle" means is the world's."""

NUMPY_RANDOM = {
    "Generator",
    "BitGenerator",
    "SeedSequence",
    "PCG64",
    "Philox",
    "default_rng",
}
TORCH_DRAWS = {
    "rand",
    "randn",
    "randint",
    "randperm",
    "multinomial",
    "bernoulli",
    "normal",
}
TORCH_SEEDS = {
    "torch.manual_seed",
    "torch.seed",
    "torch.set_rng_state",
    "torch.random.manual_seed",
}


def listed(offenders):
    """Return a message with one offender per line."""
    return "\n".join([f"{len(offenders)} offenders:", *offenders])


def test_packages_import_one_way():
    """Also: the modules at the root import no package."""
    known = {package(path) for path in modules()}
    allowed = BELOW | DOORS | {"cli": CORE}
    assert known == set(allowed), (
        "Name a new package in BELOW or DOORS, with what it may import."
    )
    offenders = [
        f"{path} imports {target}"
        for path, tree in modules().items()
        if path not in ("__init__.py", "__main__.py")
        for target in sorted(edges(path, tree))
        if package(target) not in {"", package(path), *allowed[package(path)]}
    ]
    assert not offenders, listed(offenders)


def test_the_core_can_be_imported_without_its_doors():
    """Also: every command of the core, with a door's command refused in one line."""
    packages = [f"knowarm.{door}" for door in DOORS]
    core = [
        dotted(path)
        for path in modules()
        if package(path) in CORE and path != "__main__.py"
    ]
    script = f"""
import importlib, sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name in {packages!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
for name in {core!r}:
    importlib.import_module(name)
from knowarm.cli.main import DOORS, main
print([main([command]) for command in DOORS])
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert set(ast.literal_eval(done.stdout.splitlines()[-1])) == {2}
    assert "is not installed" in done.stderr


def test_tests_of_the_core_know_no_door():
    offenders = [
        f"{path} imports {name}"
        for path, text in files("tests").items()
        if len(path.split("/")) > 2 and path.split("/")[1] in CORE
        for name in imported(path, ast.parse(text))
        if name.startswith(tuple(f"knowarm.{door}." for door in DOORS))
    ]
    assert not offenders, listed(offenders)


def test_only_the_command_line_parses_arguments():
    offenders = [
        f"{path} imports {name}"
        for path, tree in modules().items()
        for name in imported(path, tree)
        if name.split(".")[0] in ("argparse", "tyro")
        if package(path) != "cli" and path.split("/")[-1] != "command.py"
    ]
    assert not offenders, listed(offenders)


def selectors(tree):
    """Yield the string constants that are compared or matched with something, or index it."""
    for node in ast.walk(tree):
        parts = []
        if isinstance(node, ast.Compare):
            parts = [node.left, *node.comparators]
        elif isinstance(node, ast.Subscript) and ast.unparse(node.value) != "Literal":
            parts = [node.slice]
        elif isinstance(node, ast.MatchValue):
            parts = [node.value]
        for part in parts:
            several = isinstance(part, ast.Tuple | ast.List | ast.Set)
            for each in part.elts if several else [part]:
                if isinstance(each, ast.Constant) and isinstance(each.value, str):
                    yield node.lineno, each.value


def test_no_code_depends_on_the_name_of_a_robot_agent_task_or_algorithm():
    """Their registries' entries say by fields what other code must know about them."""
    everything = set().union(*REGISTRIES.values())
    offenders = [
        f"{path}:{line}: {word!r}"
        for path, tree in modules().items()
        for line, word in selectors(tree)
        if word in everything
        and not any(
            path.startswith(owner) and word in own for owner, own in REGISTRIES.items()
        )
        and not (word in OTHER_MEANINGS and path.startswith(OTHER_MEANINGS[word]))
    ]
    assert not offenders, listed(offenders)


def global_draws(tree):
    """Yield the calls that use or seed a global random state."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        start, _, last = called.rpartition(".")
        given = any(keyword.arg == "generator" for keyword in node.keywords)
        if (
            (start == "random" and last != "Random")
            or (start in ("np.random", "numpy.random") and last not in NUMPY_RANDOM)
            or called in TORCH_SEEDS
            or (
                start == "torch"
                and last.removesuffix("_like") in TORCH_DRAWS
                and not given
            )
            or (
                last in ("exponential_", "normal_", "uniform_", "random_") and not given
            )
        ):
            yield node.lineno, called


def test_every_random_number_comes_from_an_explicit_generator():
    offenders = [
        f"{path}:{line}: {called}"
        for path, tree in modules().items()
        for line, called in global_draws(tree)
    ]
    assert not offenders, listed(offenders)


def test_no_class_name_occurs_twice():
    places = defaultdict(list)
    for path, tree in modules().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(path)
    offenders = [
        f"{name}: {', '.join(at)}" for name, at in places.items() if len(at) > 1
    ]
    assert not offenders, listed(offenders)


def special_attributes():
    """Return the names that only some of the parts of tasks define."""
    parts = [*ASKED.types(), *SKILLS.types()]
    names = {name for part in parts for name in dir(part) if name[0] != "_"}
    fields = {name for part in parts for name in part.__dataclass_fields__}
    return (names | fields) - {*dir(Task), *dir(Asking), *dir(Skill)}


def task_uses(path, tree):
    """Yield where a module depends on which task it has."""
    places = [*ASKED.values(), *SKILLS.values()]
    classes = {place.replace(":", ".") for place in places}
    yield from (f"imports {name}" for name in imported(path, tree) if name in classes)
    special = special_attributes()
    for node in ast.walk(tree):
        target = None
        if isinstance(node, ast.Attribute) and node.attr in special:
            target = node.value
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in (
            "getattr",
            "hasattr",
        ):
            target = node.args[0]
        elif isinstance(
            node, ast.Dict
        ):  # overrides of fields that only some tasks have
            pairs = zip(node.keys, node.values, strict=True)
            yield from (ast.unparse(v) for k, v in pairs if k and is_overridden(k, v))
        if target is not None and is_task(target):
            yield f"{node.lineno}: {ast.unparse(node)}"


def is_overridden(key, value):
    """Return whether an item of a mapping overrides fields of a task."""
    names = ("'task'", "'asked'", "'skill'")
    return ast.unparse(key) in names and isinstance(value, ast.Dict)


def is_task(node):
    """Return whether an expression is called ``task``, or as one of its parts."""
    whole = ast.unparse(node).removesuffix(".asked").removesuffix(".skill")
    return whole.rpartition(".")[2] in ("task", "_task")


def test_only_tasks_know_which_task_it_is():
    offenders = [
        f"{path}: {use}"
        for path, tree in modules().items()
        if not path.startswith("world/tasks/")
        for use in task_uses(path, tree)
    ]
    assert not offenders, listed(offenders)


def test_every_use_of_one_task_is_found():
    assert {"queries", "objects", "height_m", "hold_steps"} <= special_attributes()
    lines = [
        "from knowarm.world.tasks.skills.reach import Reach",
        "from knowarm.world.tasks.asked.query.query import CHOOSE_TARGETS, AskObject",
        "env.task.skill.height_m + task.asked.objects",
        "getattr(config.env.task.skill, 'solid', None)",
        "config.task.asked.visible + setting.objects",
        "override(env, {'task': {'asked': {'queries': {'graph': path}}}})",
    ]
    found = [len([*task_uses("experiment/a.py", ast.parse(line))]) for line in lines]
    assert found == [1, 1, 2, 1, 0, 2]


def words(tree):
    """Yield the words of identifiers, modules and strings; docstrings are left out."""
    documented = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        texts = [
            getattr(node, name, None)
            for name in ("id", "attr", "name", "arg", "module")
        ]
        if isinstance(node, ast.Constant) and id(node) not in documented:
            texts.append(node.value)
        for text in texts:
            if isinstance(text, str):
                apart = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text).lower()
                yield from ((node, word) for word in re.findall(r"[a-z]+", apart))


def special_words(path, tree):
    """Yield where a module names what one part of a task does."""
    for node, word in words(tree):
        start = next((start for start in SPECIAL_WORDS if word.startswith(start)), None)
        if start is not None and not path.startswith(SPECIAL_WORDS[start]):
            yield f"{getattr(node, 'lineno', '?')}: {word!r}"


def test_nothing_outside_tasks_names_what_one_of_them_does():
    """They bring probes, measures, columns and tables of their own."""
    offenders = [
        f"{path}:{use}"
        for path, tree in modules().items()
        if not path.startswith("world/tasks/")
        for use in special_words(path, tree)
    ]
    assert not offenders, listed(offenders)


def test_every_word_of_one_task_is_found():
    lines = [
        "from knowarm.world.tasks.skills.lift.probe import LiftProbe",
        "Measure('lifted', 'of the successes')",
        "draw(family=1)",
        "def purpose(): pass",
        "'a sentence on lifting'.split(family_name)",
        "def grip():\n    'Lift.'",
    ]
    found = [
        len([*special_words("experiment/a.py", ast.parse(line))]) for line in lines
    ]
    assert found == [2, 1, 1, 1, 2, 0]
    assert not [*special_words("svg.py", ast.parse("draw(font_family=1)"))]


def test_mutation_testing_names_files_that_exist():
    options = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mutmut"]
    tests = options["pytest_add_cli_args_test_selection"]
    offenders = [
        path for path in (*options["only_mutate"], *tests) if not [*ROOT.glob(path)]
    ]
    assert not offenders, listed(offenders)
