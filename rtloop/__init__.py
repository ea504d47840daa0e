"""The control process: one compiled cycle between shared memory and the bus."""
