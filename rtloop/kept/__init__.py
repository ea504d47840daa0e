"""What is stored about the drives beyond the life of a control process."""
