"""Drives: what the frames of each drive family mean."""
