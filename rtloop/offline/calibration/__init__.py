"""Small moves of one drive at a time while the cycle is offline, for a person who finds out how joints are built."""
