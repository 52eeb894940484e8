"""From a joint posterior and a target state to a timed gripper path."""
