"""What the cycle remembers (`state`) and what it records: modes, events, the flight recorder."""
