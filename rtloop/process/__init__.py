"""The control process around the cycle: its start, its threads, its wire, its shutdown."""
