"""A goal on its way: its path, its clock, how it is entered, how it ends, and which limits it keeps."""
