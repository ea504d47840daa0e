"""What is used of the operating system: real-time set-up, and the few C functions that the compiled threads call."""
