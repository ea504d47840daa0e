"""What can be wrong with a memory file; each error's text is one sentence with its remedy."""


class SharedMemoryError(Exception):
    """Root of everything that can go wrong with an arm's memory files.

    Attributes:
        template: its sentence, with braces for the values that it is given with.
        values: what stands for them, so that it can be said in another language too.
    """

    def __init__(self, template: str, **values: object) -> None:
        super().__init__(template.format(**values) if values else template)
        self.template = template
        self.values = values


class NotRunning(SharedMemoryError):
    """No control process holds the arm's memory files."""


class EndedMeanwhile(NotRunning):
    """It did when somebody began to speak to it, and has died since."""


class AlreadyHeld(SharedMemoryError):
    """Another process already owns this side of the arm."""


def led_already(alone: str) -> str:
    """Why what needs an arm's drives for itself cannot begin; `alone` says what that is: "Drives are checked"."""
    return (
        f"{alone} by a control process of their own, and this arm has one already: end that first (Ctrl-C in its "
        "`rtarm up`), then run this again."
    )


class WrongLayout(SharedMemoryError):
    """The file was built by another version of rtarm, or is not one of ours at all."""


class WrongArm(SharedMemoryError):
    """The control process runs another configuration of the arm."""


class NotPermitted(SharedMemoryError):
    """The file belongs to somebody else, or is not what it should be."""


class TornRead(SharedMemoryError, TimeoutError):
    """No consistent snapshot within a bounded number of tries: the writer died or is frozen in mid-write."""


class RingFull(SharedMemoryError):
    """The consumer has not taken earlier records yet."""
