"""A simulated arm at byte level: what would be on the other end of the serial cable.

`drives/` is one file a drive family (frames in, frames out, motion), `bus.py` the CAN bus with its
bit times and arbitration, `adapter.py` the serial CAN adapter (SLCAN), `arm.py` all of it put
together in virtual time, `faults.py` what can be made to go wrong, and `pty.py` the same arm in real
time behind a pseudo-terminal (`python -m sim`).

Nothing here knows how the control loop encodes its commands: the drives are written from the facts
known about the real ones, so they can contradict it.
"""
