"""The control process around the cycle: its beginning, its threads, its wire, its end."""
