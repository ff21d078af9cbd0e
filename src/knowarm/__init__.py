"""KnowArm: triples of a knowledge graph become a vector that a robot-arm policy sees.

Two flows meet in the policy::

    triples -> subgraph -> sentence -> vectors -> scene embedding ----.
                                                                      policy -> action
    MJCF -> scene -> batch simulation -> image -----------------------'

Folders show the same way: ``knowledge`` and ``world`` feed ``policy``, ``learn`` trains it,
``experiment`` puts the parts together and ``cli`` is what people type.
"""

from knowarm.world import register_environments

__version__ = "0.1.0"

register_environments()
