"""What arm and hand can do: reach, grasps, contacts that are remembered."""
