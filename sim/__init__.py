"""PyBullet world: articulated furniture, a Franka, a noisy RGB-D camera."""
