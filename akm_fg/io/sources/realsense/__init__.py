"""How `pyrealsense2` plays a recording."""
