"""A drive's settings: what they are on the wire, what the arm file wants of them, and the conversations about them."""
