"""What the arm is: description, kinematics, limits, shape, and the laws it is driven by."""
