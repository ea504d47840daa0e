"""A service dialogue with one drive while the cycle is offline."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from config.schema import ArmConfig
from rtloop.service.conversation import Conversation, Dialogue, DialogueFailed, Part
from rtloop.service.port import ServicePort
from shm.words import Fault

Result = TypeVar("Result")


class OneDrive(Conversation, Generic[Result]):
    """A dialogue with one drive, which ends with a `result` or with a `problem`.

    A problem latches no fault: the cycle is offline, and whatever must follow (a stop) is sent by another conversation.
    """

    def __init__(
        self,
        arm: ArmConfig,
        port: ServicePort,
        *,
        now_ns: int,
        joint: int,
        dialogue: Callable[[Callable[[], int]], Part[Result]],
    ) -> None:
        """`dialogue` makes the dialogue; its argument is a clock (ns)."""
        super().__init__(arm, port, now_ns, fault=Fault.BRING_UP)
        self.result: Result | None = None
        self.problem: DialogueFailed | None = None
        self.begin({joint: self._have(dialogue(lambda: self.now_ns))})

    def _have(self, dialogue: Part[Result]) -> Dialogue:
        try:
            self.result = yield from dialogue
        except DialogueFailed as problem:
            self.problem = problem
