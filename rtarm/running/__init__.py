"""A running arm as seen from outside, through shared memory alone: what it says of itself and what it is asked."""
