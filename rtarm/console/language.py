"""In which language a person is told something: English, unless Chinese was asked for with `--language zh`.

A sentence stands in English where it is said, and in Chinese in `chinese` under its English. Those about faults, goals
and requests come from `sentences.told`. JSON, recordings and logs are English always: programs read them.
"""

from __future__ import annotations

from collections.abc import Mapping

from rtarm.console.chinese import SENTENCES
from rtarm.console.errors import Refusal
from sentences.meaning import Language
from shm.errors import SharedMemoryError

LANGUAGES: dict[str, Language] = {"en": "en", "zh": "zh"}


def language_of(given: str) -> Language:
    """The language that a person asked for; raises Refusal where rtarm does not speak it."""
    if given not in LANGUAGES:
        raise Refusal(f"--language is {given!r}, but rtarm speaks {' and '.join(LANGUAGES)} only: choose one.")
    return LANGUAGES[given]


def said(language: Language, english: str, /, **values: object) -> str:
    """A sentence, with these values in its braces."""
    return (english if language == "en" else SENTENCES[english]).format(**values)


def named(language: Language, chinese: Mapping[str, str], key: str) -> str:
    """What people call one of a few things that JSON has by a key, such as `bringing_up`."""
    return chinese.get(key, key) if language == "zh" else key.replace("_", " ")


def told(problem: SharedMemoryError, language: Language) -> str:
    """What is wrong with an arm's memory files; what befalls no arm that runs as it should is English always."""
    if problem.template in SENTENCES:
        phrases = {name: SENTENCES.get(str(value), value) for name, value in problem.values.items()}
        return said(language, problem.template, **(problem.values if language == "en" else phrases))
    return str(problem)
