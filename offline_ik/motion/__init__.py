"""From the arm's posture to a detector position: approach, paths, and the simulation of a move."""
