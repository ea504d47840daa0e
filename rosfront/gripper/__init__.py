"""The gripper's half of the ROS process: a small hook that moves it, and what ROS is offered of it."""
