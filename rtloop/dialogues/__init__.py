"""Conversations with the drives: bring-up, homing, letting go, going on after a stall, the gripper."""
