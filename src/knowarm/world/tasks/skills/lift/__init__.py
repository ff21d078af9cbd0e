"""Lifting: the skill, the physics of its fingers and objects, its teacher, and the lift test."""
