"""Motions of a running arm through its ordinary action, so that every check of a MoveIt goal applies to them.

`program` is the process that speaks ROS, with what our ROS programs share in `ros`; `sender` starts it and needs no
ROS; `moves` are motions that a person has agreed to.
"""
