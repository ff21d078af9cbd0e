"""Robots as users have them: a plain arm of six joints and two fingers, and what is unusual."""

import re

ARM = """<mujoco model="plain"><compiler angle="radian"/>
  <default><geom rgba=".9 .5 .1 1"/><joint damping="1" armature=".05" range="-2.9 2.9"/></default>
  <worldbody>
  <body name="base"><geom type="cylinder" size=".08 .05" pos="0 0 .05"/>
  <body name="l1" pos="0 0 .1"><joint name="j1" axis="0 0 1"/>
    <geom type="cylinder" size=".06 .08" pos="0 0 .08"/>
  <body name="l2" pos="0 0 .2"><joint name="j2" axis="0 1 0" range="-1.8 1.8"/>
    <geom type="capsule" size=".05" fromto="0 0 0 0 0 .35"/>
  <body name="l3" pos="0 0 .35"><joint name="j3" axis="0 1 0" range="-2.6 2.6"/>
    <geom type="capsule" size=".045" fromto="0 0 0 0 0 .3"/>
  <body name="l4" pos="0 0 .3"><joint name="j4" axis="0 0 1"/><geom size=".04"/>
  <body name="l5" pos="0 0 .05"><joint name="j5" axis="0 1 0" range="-2.1 2.1"/>
    <geom type="sphere" size=".04"/>
  <body name="l6" pos="0 0 .06"><joint name="j6" axis="0 0 1"/>
    <geom type="box" size=".03 .05 .02" pos="0 0 .02"/>
    <body name="left" pos="0 .03 .06"><joint name="left" type="slide" axis="0 1 0" range="0 .03"/>
      <geom type="box" size=".01 .005 .03"/></body>
    <body name="right" pos="0 -.03 .06"><joint name="right" type="slide" axis="0 -1 0"
      range="0 .03"/><geom type="box" size=".01 .005 .03"/></body>
  </body></body></body></body></body></body></body></worldbody></mujoco>"""
LEFT = ARM[ARM.index('<body name="left"') : ARM.index('<body name="right"')]
RIGHT = ARM[
    ARM.index('<body name="right"') : ARM.index("</body></body></body></body>") - 9
]
BASE = '<body name="base">'
SECOND = ARM[ARM.index(BASE) : ARM.index("</worldbody>")].replace('name="', 'name="r')
JAW = """<body name="jaw" pos="0 .03 .04"><joint name="{}" axis="1 0 0" range="-.2 1.2"/>
  <geom type="box" size=".01 .005 .03" pos="0 0 .03"/></body>"""
FIXED = '<geom type="box" size=".01 .005 .03" pos="0 -.03 .06"/>'
CUBE = (
    '<body name="cube{0}" pos=".4 .1 .{0}"><freejoint/>'
    '<geom type="box" size=".03 .03 .03"/></body>'
)
TORSO = """<body name="waist"><joint name="w1" axis="0 0 1" range="-1 1"/><geom size=".1"/>
  <body name="chest" pos="0 0 .1"><joint name="w2" axis="0 1 0" range="-.5 1"/><geom size=".1"/>
  <body name="head" pos="0 0 .3"><joint name="neck" axis="0 0 1"/><geom size=".1"/></body>"""
DRIVE = """<body name="base"><joint name="x" type="slide" axis="1 0 0" range="-2 2"/><joint name="y"
  type="slide" axis="0 1 0" range="-2 2"/><joint name="turn" axis="0 0 1"/>"""


def change(*pairs: tuple[str, str]) -> str:
    text = ARM
    for old, new in pairs:
        assert old in text, old
        text = text.replace(old, new)
    return text


CASES = {
    "plain": ARM,
    "gripper hinge named joint7": change((LEFT, JAW.format("joint7")), (RIGHT, FIXED)),
    "finger named drive joint": change(
        (LEFT, JAW.format("drive_joint")),
        (
            RIGHT,
            JAW.format("other").replace("jaw", "other").replace(".03 .04", "-.03 .04"),
        ),
    ),
    "one moving jaw": change((RIGHT, FIXED)),
    "two arms": change(
        ("</worldbody>", f"{SECOND}</worldbody>"),
    ),
    "waist, head and arm": change(
        (BASE, f'{TORSO}<body name="base" pos="0 -.2 .1">'),
        ("</worldbody>", "</body></body></worldbody>"),
    ),
    "mobile base": change((BASE, DRIVE)),
    "faces -y": change(
        (BASE, '<body name="base" euler="0 0 -1.5708">'),
        ('name="j1" axis="0 0 1"', 'name="j1" axis="0 0 1" range="-.8 .8"'),
    ),
    "base away from the origin": change((BASE, '<body name="base" pos="-.47 0 0">')),
    "free base": change((BASE, '<body name="base" pos="0 0 1.5"><freejoint/>')),
    "on the wall": change((BASE, '<body name="base" pos="0 0 .8" euler="0 1.5708 0">')),
    "on the ceiling": change(
        (BASE, '<body name="base" pos="0 0 1.2" euler="3.1416 0 0">')
    ),
    "base plate below the floor": change(('pos="0 0 .05"/>\n', 'pos="0 0 .04"/>\n')),
    "own table and cube": change(
        (
            BASE,
            f'<body name="table" pos=".5 0 .2"><geom size=".2"/></body>{CUBE.format(5)}{BASE}',
        )
    ),
    "own floor": change(
        (BASE, f'<geom type="plane" pos="0 0 .06" size="2 2 .1"/>{BASE}')
    ),
    "loose cubes": change((BASE, CUBE.format(1) + CUBE.format(3) + BASE)),
    "unnamed joint": change(('name="j3" ', "")),
    "all joints unnamed": change(*((f'name="j{i}" ', "") for i in range(1, 7))),
    "names with space, slash, umlaut": change(
        ("j1", "Gelenk 1 / &#252;"), ("l6", "&quot;6&quot;")
    ),
    "zero inertia": change(
        (' armature=".05"', ""), ('<geom type="sphere"', '<geom mass="0"')
    ),
    "tiny inertia": change(
        (' armature=".05"', ""), ("<geom rgba", '<geom density="1" rgba')
    ),
    "ball joint": change(
        ('name="j4" axis="0 0 1"', 'name="j4" type="ball" range="0 2"')
    ),
    "two joints in one body": change(
        (
            'range="-1.8 1.8"/>',
            'range="-1.8 1.8"/><joint name="j2b" axis="1 0 0" range="-.5 .5"/>',
        )
    ),
    "coupled joints": change(
        ("</mujoco>", '<equality><joint joint1="j3" joint2="j2"/></equality></mujoco>')
    ),
    "no ranges": change(
        (' range="-2.9 2.9"', ""),
        (
            "</mujoco>",
            '<actuator><position joint="j1" ctrlrange="-2 2"/></actuator></mujoco>',
        ),
    ),
    "range excludes zero": change(("-2.6 2.6", ".5 2.6")),
    "mirrored reference": change(('range="-2.6 2.6"', 'range="-1.03 4.17" ref="1.57"')),
    "one link in group 3": change(
        ('"capsule" size=".05"', '"capsule" group="3" size=".05"')
    ),
    "all geoms in group 3": change(("<geom rgba", '<geom group="3" rgba')),
    "strong friction": change(('damping="1"', 'damping="60" frictionloss="40"')),
    "missing mesh": change(
        ("<default>", '<asset><mesh name="m" file="no.stl"/></asset><default>')
    ),
    "springs": change(('damping="1"', 'damping="1" stiffness="200" springref=".5"')),
    "force limits": change(("armature", 'actuatorfrcrange="-12 12" armature')),
    "keyframe of another size": change(
        ("</mujoco>", '<keyframe><key qpos="0 0 0 0 0 0 0 0"/></keyframe></mujoco>')
    ),
    "site with z backward": change(
        (LEFT, f'<site name="tcp" pos="0 0 .08" euler="3.1416 0 0"/>{LEFT}')
    ),
    "cone": change(
        (
            "<default>",
            '<option timestep=".002" impratio="10" cone="elliptic"/><default>',
        )
    ),
    "sizes": change(
        (
            "<default>",
            '<size njmax="500" nconmax="2000" nuserdata="3"/><default>',
        )
    ),
    "fingers drawn closed": change(
        ("0 .03 .06", "0 .005 .06"), ("0 -.03 .06", "0 -.005 .06")
    ),
    "in centimetres": re.sub(
        r'(pos|size|fromto)="([^"]*)"',
        lambda m: f'{m[1]}="{" ".join(str(100 * float(x)) for x in m[2].split())}"',
        ARM,
    ),
}
"""Texts of MJCF files by what is unusual."""


URDF_LINK = """<link name="{0}"><inertial><origin xyz="0 0 {2}"/><mass value="1"/>
  <inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><origin xyz="0 {1} {2}"/><geometry>{3}</geometry></visual>
  <collision><origin xyz="0 {1} {2}"/><geometry>{3}</geometry></collision></link>"""
URDF_JOINT = """<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>
  <origin xyz="0 0 {4}"/><axis xyz="{5}"/>{6}</joint>"""
URDF_LENGTHS = (0.1, 0.12, 0.3, 0.28, 0.08, 0.08, 0.06)
URDF_AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
LIMIT = '<limit lower="{}" upper="{}" effort="80" velocity="3"/>'


def as_urdf(
    left: str = "", right: str = "", limit: str = LIMIT.format(-2.9, 2.9)
) -> str:
    """Return a URDF of six joints, j1 to j6, with a limit; fingers if those have one."""
    text = ""
    for i, length in enumerate(URDF_LENGTHS):
        box = f'<box size=".06 .06 {length}"/>'
        text += URDF_LINK.format(f"l{i}", 0, length / 2, box)
        if i:
            axis = URDF_AXES[i - 1]
            text += URDF_JOINT.format(
                f"j{i}",
                "revolute",
                f"l{i - 1}",
                f"l{i}",
                URDF_LENGTHS[i - 1],
                axis,
                limit,
            )
    fingers = (("left", left, -0.006), ("right", right, 0.006))
    for name, end, offset in fingers:
        if end:
            text += URDF_LINK.format(name, offset, 0.03, '<box size=".02 .01 .06"/>')
            text += URDF_JOINT.format(name, "prismatic", "l6", name, 0.06, "0 1 0", end)
    return f'<robot name="arm">{text}</robot>'
