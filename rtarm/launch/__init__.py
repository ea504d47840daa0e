"""The processes of an arm: started in order, watched, ended together; on the command line and in ROS clothing."""
