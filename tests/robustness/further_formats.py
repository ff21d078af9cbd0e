"""Further formats of the campaign of mutations: robots, ontologies, datasets, calibrations."""

import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

from knowarm.cli.main import main
from knowarm.deploy.joint_map import real_joints
from knowarm.knowledge import read_graph
from knowarm.own_robot.calibration import read_calibration
from knowarm.own_robot.urdf import as_mjcf
from knowarm.study.config import read_study
from knowarm.world.objects import find_targets
from knowarm.world.robots import find_robot
from knowarm.world.scene.mjcf import read_mjcf
from knowarm.world.scene.scene import load_scene
from knowarm.world.viewing.dataset import write_dataset_page
from tests.source_tree import ROOT

Reader = tuple[str, Path, Callable[[Path], object]]
"""Name of a format, the file that is mutated, and how it is read."""

LINK = """<link name="l{i}"><inertial><mass value=".5"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3"
ixy="0" ixz="0" iyz="0"/></inertial><visual><geometry><cylinder radius=".05" length=".2"/>
</geometry></visual></link><joint name="j{i}" type="revolute"><parent link="{parent}"/>
<child link="l{i}"/><origin xyz="0 0 .2" rpy="0 0 {i}"/><axis xyz="0 1 0"/>
<limit lower="-1.5" upper="1.5" effort="9" velocity="2"/></joint>"""
XACRO = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="n" default="3"/>
<xacro:property name="half" value="${pi / 2}"/><xacro:macro name="arm" params="i parent">%s
</xacro:macro><link name="base"/><xacro:arm i="1" parent="base"/><xacro:if value="$(arg n)">
<xacro:arm i="2" parent="l1"/></xacro:if></robot>"""
ONTOLOGIES = {
    "ofn": "Prefix(:=<http://a/>)\nOntology(<http://a/o>\n{}\n)",
    "omn": "Prefix: : <http://a/>\nOntology: <http://a/o>\n{}",
    "owx": '<Ontology xmlns="http://www.w3.org/2002/07/owl#" ontologyIRI="http://a/o">{}</Ontology>',
    "obo": "format-version: 1.2\nontology: a\n\n{}",
}
AXIOMS = {
    "ofn": "SubClassOf(:C{i} ObjectSomeValuesFrom(:usedFor ObjectComplementOf(:C{j})))\n",
    "omn": "Class: :C{i}\n  SubClassOf: :usedFor some (not (:C{j}))\n",
    "owx": '<SubClassOf><Class IRI="http://a/C{i}"/><ObjectComplementOf><Class IRI="http://a/C{j}"/>'
    "</ObjectComplementOf></SubClassOf>",
    "obo": "[Term]\nid: A:{i}\nname: thing {i}\nis_a: A:{j}\n\n",
}


def further_readers(folder: Path) -> list[Reader]:
    """Write whole files of these formats into a folder."""
    folder.mkdir()
    return [*_robots(folder), *_ontologies(folder), *_datasets(folder), *_texts(folder)]


def _robots(folder: Path) -> list[Reader]:
    own = shutil.copytree(ROOT / "examples" / "own_robot", folder / "own")
    links = [
        LINK.format(i=i, parent=f"l{i - 1}" if i > 1 else "base") for i in (1, 2, 3)
    ]
    urdf, xacro = folder / "arm.urdf", folder / "arm.xacro"
    urdf.write_text(f'<robot name="r"><link name="base"/>{"".join(links)}</robot>')
    macro = LINK.replace("{i}", "${i}").replace("{parent}", "${parent}")
    xacro.write_text(XACRO % macro)

    def convert(path: Path) -> None:
        try:
            as_mjcf(path, folder / "made")
        finally:
            shutil.rmtree(folder / "made", ignore_errors=True)

    def scene(path: Path) -> None:
        find_robot(str(path))
        load_scene(str(path), ("mug",))

    return [
        ("URDF", urdf, convert),
        ("xacro", xacro, convert),
        ("MJCF", own / "scara.xml", partial(read_mjcf, owner="Robot 'a'")),
        ("robot's description", own / "scara.toml", scene),
        ("object's description", own / "bowl.toml", lambda p: find_targets([str(p)])),
    ]


def _ontologies(folder: Path) -> list[Reader]:
    readers: list[Reader] = []
    for suffix, text in ONTOLOGIES.items():
        path = folder / f"a.{suffix}"
        axioms = [AXIOMS[suffix].format(i=i, j=i + 1) for i in range(30)]
        path.write_text(text.format("".join(axioms)))
        readers.append((f"ontology .{suffix}", path, read_graph))
    return readers


def _datasets(folder: Path) -> list[Reader]:
    dataset, page = folder / "dataset", folder / "page.html"
    words = ["record", "oracle", "--episodes", "1", "--to", str(dataset)]
    assert main(words) == 0
    names = ("meta/info.json", "meta/tasks.parquet", "data/chunk-000/file-000.parquet")
    return [
        (
            f"dataset {name}",
            dataset / name,
            lambda _: write_dataset_page(dataset, page, 1),
        )
        for name in names
    ]


def _texts(folder: Path) -> list[Reader]:
    motor = {"drive_mode": 0, "homing_offset": 5, "range_min": 700, "range_max": 3400}
    motors = {name: {"id": i, **motor} for i, name in enumerate(("pan", "gripper"))}
    calibration = folder / "calibration.json"
    calibration.write_text(json.dumps(motors))
    scene = load_scene("irb120", ("mug",))
    lines = [
        f'joint_{i} = {{name = "j{i}", sign = -1, offset = 2.5}}' for i in range(1, 7)
    ]
    joint_map = folder / "map.toml"
    joint_map.write_text("\n".join(["[joint_map]", *lines]))
    study = folder / "study.toml"
    study.write_text('name = "s"\nexperiments = ["irb120-full-fast"]\nseeds = [0, 1]\n')
    return [
        ("calibration", calibration, read_calibration),
        ("joint map", joint_map, lambda path: real_joints(scene, path)),
        ("study", study, read_study),
    ]
