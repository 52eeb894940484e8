"""Whether camera, gripper and what is said of them agree with what is seen."""
