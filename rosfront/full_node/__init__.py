"""The arm's full node: motions that it plans itself, by angles, by pose or on a straight line."""
