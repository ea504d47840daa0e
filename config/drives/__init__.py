"""Families of drives, one file each: what stands in an arm file, and what its drives do to the bus."""
