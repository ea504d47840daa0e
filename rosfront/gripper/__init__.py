"""The gripper's part of the ROS process: a small hook that moves it, and its ROS interfaces."""
