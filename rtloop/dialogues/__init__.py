"""Conversations with the drives: bring-up, homing, release, recovery after a stall, shutdown, the gripper."""
