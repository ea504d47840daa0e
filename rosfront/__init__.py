"""The ROS process: goals come in, the arm's state goes out."""
