"""Why a wire cannot be used."""


class WireRefused(Exception):
    """The adapter cannot be used; the text is the sentence for the operator."""
