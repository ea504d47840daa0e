"""Turning one drive a little at a time beside an offline cycle, for a person who finds out how its joint is built."""
