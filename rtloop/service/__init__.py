"""The in-process rings between the cycle and ordinary Python, and the conversations that go through them."""
