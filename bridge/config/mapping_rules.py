"""The check of the files that ``types.mapping_rules`` names."""

from __future__ import annotations

from bridge.config.document import Document, Problem
from bridge.config.model import Config


def mapping_rule_problems(document: Document, config: Config) -> list[Problem]:
    """Return a problem for each file that cannot be read, and each entry that is wrong or cannot apply."""
    files = config.types.mapping_rules
    if not files:
        return []
    from bridge.messages.errors import MessageTypeError
    from bridge.messages.mapping.rules import load_rules
    from bridge.messages.mapping.version_rules import load_version_rules
    from bridge.messages.registry import Registry

    def problem(index: int, err: MessageTypeError) -> Problem:
        return document.problem(("types", "mapping_rules", index), f"{err}; {err.cure}" if err.cure else str(err))

    problems: list[Problem] = []
    versioned = False
    for index, file in enumerate(files):
        try:
            load_rules(file)
            versioned = bool(load_version_rules(file)) or versioned
        except MessageTypeError as err:
            problems.append(problem(index, err))
    if problems or not versioned:
        return problems
    for wrong in Registry.of(config.types).rule_errors():
        index = next((number for number, file in enumerate(files) if str(wrong).startswith(f"{file}, ")), 0)
        problems.append(problem(index, wrong))
    return problems
