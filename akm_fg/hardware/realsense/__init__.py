"""A RealSense camera (`pyrealsense2`)."""
