"""`rtarm demo`: recorded goals through the real processes on a simulated arm."""
