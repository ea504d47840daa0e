"""A drive's settings: their form on the wire, what the arm file wants, and the dialogues that read and write them."""
