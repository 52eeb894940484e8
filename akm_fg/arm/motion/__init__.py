"""How the arm moves: obstacles, free ways, grasps it can reach, timing, pulls and paths."""
