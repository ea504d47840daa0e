"""Recordings of an arm's last half minute: written after a fault or on demand, told, drawn and played back.

`shm.recording` reads what the flight recorder has kept; `mcap_writer` makes a file of it, `mcap_reader` reads that
again, `mcap_format` is what they agree on; `folder` says where such files are kept and how many, `make` brings the two
together. `story` tells a recording, `chart` draws one joint of it, `explain` shows both, `playback` reads it in
time, and `after_fault` is the launcher's: it has a process of its own (`python -m rtarm.recording`) write a file.
"""
