"""What the cycle remembers (`state`) and what it tells of itself: modes, events, the flight recorder."""
