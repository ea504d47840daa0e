"""The records of the cycle's own memory, which say who stores into them."""

from typing import ClassVar

import numpy as np

from shm.record import Record


class OwnedRecord(Record):
    """A record of the cycle's memory.

    Attributes:
        writers: modules and rooms of rtloop whose compiled functions store into its fields, which a test compares with
            the code. Not among them are the parts' own functions (`memory.updates`); what is stored at an
            address, as the positions of rings are; and what ordinary Python stores: everything before the first cycle
            (`process.initial_state`), and later that it has taken up what `Dialogue` asks for, that the process is
            `closing`, and the records of `service_in`.
    """

    writers: ClassVar[tuple[str, ...]]

    def __init_subclass__(cls, *, writers: tuple[str, ...]) -> None:
        super().__init_subclass__()
        # of np.record, whose fields are attributes without the compiler too
        cls.dtype = np.dtype((np.record, cls.dtype))
        cls.writers = writers
