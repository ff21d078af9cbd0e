"""Tasks: what is drawn for an episode, how actions move the arm, and how the result is judged."""
