"""One cycle's frames: what has come from the drives, and what goes to them."""
