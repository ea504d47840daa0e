"""What the cycle takes from others: from people, from the front, from the conversations."""
