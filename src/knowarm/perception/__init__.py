"""Perception: networks that recognize objects in images, and agents that act on their output.

`GroundingNetwork` (`grounding`) finds the object that a query means and predicts its grasp frame.
It holds a `PlaceEncoder` (`encoder`) and is trained by `grounding_training` on images that the
simulator labels (`images`). `recognition` gives a policy what it recognizes.
"""
