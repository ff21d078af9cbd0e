"""Lift test: whether a gripper that closes where an episode ended holds the object."""
