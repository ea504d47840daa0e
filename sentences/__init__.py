"""What the numbers in shared memory mean to a person, in English and Chinese."""
