"""What a real Franka needs too: kinematics, obstacles, free motion, limits, timing, compliance."""
