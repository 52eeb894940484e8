"""The simulated Franka: what drives and senses it."""
