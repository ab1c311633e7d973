"""Definitions of message types that workers tell each other, and tools: of types that the asker does not have."""

from __future__ import annotations

from collections.abc import Iterable

from bridge.hub.control import WorkerAnswer

VERB = "type"
"""The question on the control plane, with the parameter ``name``."""

MAX_DEFINITION = 1024 * 1024
"""Characters of the longest definition that is taken."""


def definition_among(answers: Iterable[WorkerAnswer], type_hash: str = "") -> str | None:
    """The first definition that was told, with this very hash unless that is ""; None where nobody knew it."""
    for answer in answers:
        value = answer.value if isinstance(answer.value, dict) else {}
        definition = value.get("definition")
        fits = not type_hash or value.get("hash") == type_hash
        if fits and isinstance(definition, str) and len(definition) < MAX_DEFINITION:
            return definition
    return None
