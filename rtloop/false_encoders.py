"""Which arm file may not be started, because a bench test has found that an encoder of it does not know its angle."""

from config.schema import ArmConfig
from rtloop import commissioned
from rtloop.commissioned import NotReadable, PowerProof
from rtloop.process import CannotStart


def refuse_false_encoders(arm: ArmConfig) -> None:
    """Refuse an arm file that says absolute of a drive whose bench test has found that it loses its angle.

    Raises:
        CannotStart: with what was found.
    """
    try:
        known = commissioned.load(arm)
    except NotReadable:
        return  # which is told elsewhere
    for joint, found in known.items():
        config = arm.joints[joint]
        if config.drive.knows_its_angle and found.power_proof is PowerProof.NONE:
            raise CannotStart(
                f"The encoder of {config.name} is absolute in the arm file, but its bench test of {found.when[:10]} "
                f"has found otherwise ({found.power}), so its angle cannot be believed: mend `encoder` in the arm "
                "file, or test it again with `rtarm commission`."
            )
