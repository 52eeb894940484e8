"""What a ROS bag holds, as `rosbags` hands it on: pictures, cameras, transforms."""
