"""Scene: the MuJoCo model of a robot and its objects, and what varies in its appearance."""
