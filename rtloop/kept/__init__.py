"""What is known of the drives beyond the life of a control process."""
