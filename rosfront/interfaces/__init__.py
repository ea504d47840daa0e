"""Interface definitions of control_msgs, and what makes a Python package of them where ROS has none."""
