"""Draw the families: instances of each kind as an image, and what holds for them as a graph.

    python scripts/draw_families.py

writes docs/images/families.png, 4 x 4 instances per kind, and the shipped graph families.
"""

from pathlib import Path

import mujoco
from PIL import Image, ImageDraw

from knowarm.questions import kind_of
from knowarm.world.objects.target import COLOURS
from knowarm.world.scene.compose import read_mjcf
from knowarm.world.tasks.asked.family.families import (
    FAMILIES,
    FAMILY_COLOURS,
    KINDS,
    facts,
    instance,
)

ROOT = Path(__file__).parent.parent
GRAPH = ROOT / "src/knowarm/knowledge/data/families.ttl"
TILE, PER_SIDE, COLUMNS = 76, 4, 5

HEADER = """\
# Facts about the instances of the families task (Apache-2.0), written by
# scripts/draw_families.py from the templates in src/knowarm/world/tasks/asked/family/families.toml.

@prefix : <urn:knowarm:> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
"""

VALUES = """\
# ---------------------------------------------------------------- links between values

:drinking :relatedTo :tea, :water, :wine, :pouring .
:pouring :relatedTo :water, :spout, :serving .
:serving :relatedTo :soup, :fruit, :tea .
:storing :relatedTo :lid, :fruit, :wood .
:lighting :relatedTo :decorating .
:decorating :relatedTo :flower, :living_room .
:ceramic :similarTo :glass .
:metal :relatedTo :workshop .
:wood :relatedTo :workshop .
:cylindrical :similarTo :round .
:square :relatedTo :storing .
:tea :similarTo :water .
:wine :similarTo :water .
:soup :similarTo :fruit .
:fruit :relatedTo :kitchen .
:flower :relatedTo :living_room .
:kitchen :relatedTo :living_room .
:neck :relatedTo :spout .
:rim :relatedTo :lid .
:foot :similarTo :handle .
"""


def graph() -> str:
    """Return the graph of all instances as Turtle."""
    blocks = [HEADER]
    for name in FAMILIES:
        stated = [
            f":{relation} {', '.join(f':{value}' for value in values)}"
            for relation, values in facts(name).items()
            if values
        ]
        blocks.append(f':{name} rdfs:label "{kind_of(name)}" ; {" ; ".join(stated)} .')
    colours = "\n".join(f":{colour} a :colour ." for colour in FAMILY_COLOURS)
    return "\n".join([*blocks, "", VALUES, colours.replace(" a ", " :isA "), ""])


def picture(name: str, colour: tuple[float, float, float]) -> Image.Image:
    """Draw an instance with its grasp point in magenta."""
    target = instance(name)
    spec = read_mjcf(target.mjcf, name, target.xml)
    for geom in spec.geoms:
        if geom.name in target.coloured_geoms:
            geom.rgba = [*colour, 1]
    site = spec.sites[0]
    site.size, site.rgba = [0.006, 0, 0], [1, 0, 1, 1]
    spec.worldbody.add_light(pos=[0.3, -0.6, 1], dir=[-0.3, 0.6, -1])
    floor = spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[20, 20, 0.1]
    )
    floor.rgba = [0.9, 0.9, 0.92, 1]
    spec.visual.headlight.ambient = [0.4, 0.4, 0.4]
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.lookat, camera.distance = [0, 0, 0.10], 0.44
    camera.azimuth, camera.elevation = 110, -35
    with mujoco.Renderer(model, 2 * TILE, 2 * TILE) as renderer:
        renderer.update_scene(data, camera)
        image = Image.fromarray(renderer.render())
    return image.resize((TILE, TILE), Image.Resampling.LANCZOS)


def main() -> None:
    """Write graph and image."""
    GRAPH.write_text(graph(), encoding="utf-8")
    side = TILE * PER_SIDE
    rows = -(-len(KINDS) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * (side + 8), rows * (side + 24)), "white")
    draw = ImageDraw.Draw(sheet)
    shades = list(COLOURS.values())
    for number, kind in enumerate(KINDS):
        left, top = number % COLUMNS * (side + 8), number // COLUMNS * (side + 24)
        draw.text((left + 4, top + 4), kind, fill="black", font_size=14)
        for i in range(PER_SIDE**2):
            tile = picture(f"{kind}-{i}", shades[i % len(shades)])
            sheet.paste(
                tile, (left + i % PER_SIDE * TILE, top + 22 + i // PER_SIDE * TILE)
            )
    sheet.quantize(128, dither=Image.Dither.NONE).save(
        ROOT / "docs/images/families.png"
    )


if __name__ == "__main__":
    main()
