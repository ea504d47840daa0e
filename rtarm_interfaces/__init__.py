"""Interface definitions of control_msgs and robot_arm_interfaces, and what makes Python packages of them."""
