"""The command line: `application` with what concerns a whole arm, and a file for each other group of commands.

`frame` is what all commands share, `completion` what a shell offers.
"""
