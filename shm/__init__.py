"""The two memory files through which the control process and everybody else talk."""
