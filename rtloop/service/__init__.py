"""The in-process rings between the cycle and ordinary Python, and the conversations with drives that use them."""
