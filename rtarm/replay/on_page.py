"""`rtarm replay --view`: a recording played back in the page that shows a running arm (`rtarm.view`)."""

from __future__ import annotations

import math
from collections.abc import Callable

from rtarm.console.errors import Refusal, needs
from rtarm.running.arm_file import arm_file
from sentences.meaning import Language
from shm.recording import Recording


def show_on_page(
    recording: Recording, argument: str | None, speed: float, language: Language, tell: Callable[[str], None]
) -> None:
    """Serve the page of a recording until a signal.

    Args:
        argument: name or file of the arm that is drawn; None for the one that was recorded.
        speed: 1 is as it happened.
        language: of the page.
        tell: is told where the page is.

    Raises:
        Refusal, ConfigError: it cannot be drawn or served.
    """
    needs("viser")
    from rtarm.recording.playback import Playback
    from rtarm.view.gate import open_server
    from rtarm.view.run import serve
    from rtarm.view.source import RecordedArm
    from rtarm.view.words import WORDS

    if not (math.isfinite(speed) and speed > 0):
        raise Refusal(f"--speed is {speed:g}, but a recording plays forward only: give a factor above 0, such as 0.5.")
    arm = arm_file(argument, recording.arm)
    joints = tuple(joint.name for joint in arm.joints)
    if joints != recording.joints:
        raise Refusal(
            f"The recording is of an arm with the joints {', '.join(recording.joints)}, and {arm.name} has "
            f"{', '.join(joints)}: give the file of the arm that was recorded with --arm."
        )
    opened = open_server()
    tell(f"{opened.url} plays the recording of {recording.arm}; Ctrl-C ends the page.")
    shown = RecordedArm(recording, Playback(recording, speed, language=language))
    serve(opened.server, arm, shown, None, WORDS[language])
