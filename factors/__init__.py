"""GTSAM factors and the joint kinematics they share. Depends on numpy and gtsam only."""
