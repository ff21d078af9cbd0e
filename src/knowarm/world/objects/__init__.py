"""An object's name goes in; its ``Target`` description comes out."""

from knowarm.world.objects.bottle import BOTTLE
from knowarm.world.objects.cereal_box import CEREAL_BOX
from knowarm.world.objects.mug import MUG
from knowarm.world.target import Target

TARGETS: dict[str, Target] = {
    "mug": MUG,
    "bottle": BOTTLE,
    "cereal_box": CEREAL_BOX,
}
"""Every target by name. A new one is two files beside these and one line here."""
