"""The command line: starts, shows and stops the processes of an arm."""
