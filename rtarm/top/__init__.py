"""`rtarm top`: a running arm's figures, live in a terminal, from its memory files mapped read-only.

`events` says what stands in the event ring, `watch` looks again and again and follows restarts, `picture` draws a look
into whatever room there is, `terminal` borrows the terminal and gives it back.
"""
