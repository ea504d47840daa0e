"""What the operating system is asked for: punctuality, and the few C functions of the compiled threads."""
