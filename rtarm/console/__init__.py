"""How a command speaks and ends: languages, lines, sentences of refusal with their exit codes, signals, niceness."""
