"""Camera intrinsics and hand-eye calibration from images of a ChArUco board and robot poses."""
