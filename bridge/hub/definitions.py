"""Requests for message definitions, with which workers and tools get missing definitions from other workers."""

from __future__ import annotations

from collections.abc import Iterable

from bridge.hub.control import WorkerAnswer

VERB = "type"
"""The request on the control plane, with the parameter ``name``."""

MAX_DEFINITION = 1024 * 1024
"""Maximum length of an accepted definition, in characters."""


def definition_among(answers: Iterable[WorkerAnswer], type_hash: str = "") -> str | None:
    """Return the first definition with ``type_hash`` ("" for any) in the answers; None if no worker has it."""
    for answer in answers:
        value = answer.value if isinstance(answer.value, dict) else {}
        definition = value.get("definition")
        fits = not type_hash or value.get("hash") == type_hash
        if fits and isinstance(definition, str) and len(definition) <= MAX_DEFINITION and _is_unicode(definition):
            return definition
    return None


def _is_unicode(text: str) -> bool:
    """Return whether a text can be encoded; JSON may have half of a surrogate pair."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True
