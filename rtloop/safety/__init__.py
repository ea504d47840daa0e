"""What is commanded and measured against the limits, and what happens where they are not kept."""
