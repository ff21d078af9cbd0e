"""Perception: networks that recognize objects in images, and agents that act on their output.

`FacetClassifier` (`classifier`) names the visible objects and their colours; `GroundingNetwork`
(`grounding`) finds the object that a query means and predicts its grasp frame. Both hold a
`PlaceEncoder` (`encoder`), are trained by `training` on images that the simulator labels
(`images`), and are stored as `module` describes. `agent` gives a policy what they recognize.
"""
