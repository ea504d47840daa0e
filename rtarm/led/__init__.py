"""A joint that its ordinary control process leads alone, for a person who tests or measures it."""
