"""Wires: how bytes reach the bus and come back."""
