"""Motions of a running arm through its ordinary action, so that every check of a MoveIt goal applies to them.

`program` is the one process of ours that sends goals, with what our ROS programs share in `ros` and how messages arrive
in `arrivals`. Who starts it needs no ROS: `sender` sends goals to an arm and follows their end, `player` (a `partner`
in lines of JSON) measures for demo and benchmark. `moves` are motions that a person has agreed to.
"""
