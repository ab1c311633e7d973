"""Verbs that inspect the daemon and its machine: log, doctor, configuration."""

from __future__ import annotations

import contextlib
import threading
from typing import Any

import yaml

from bridge.client.session import Client
from bridge.config.document import ConfigError, text_of
from bridge.web.sources.log import LEVELS, LogFollower
from bridge.web.verbs.config_text import Secrets, config_file, secrets_of, show_config
from bridge.web.verbs.verbs import PageVerb, VerbError

_MOST_TEXT = 200


class Doctor:
    """Runs the checks of ``midspan doctor``, one run at a time. It blocks, so never call it on the module's thread."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._lock = threading.Lock()

    def __call__(self) -> list[dict[str, str]]:
        """Return an entry for each finding; raises `VerbError` if the doctor is already running."""
        if not self._lock.acquire(blocking=False):
            raise VerbError("the doctor is already running; try again in a moment")
        try:
            return self._examine()
        finally:
            self._lock.release()

    def _examine(self) -> list[dict[str, str]]:
        from bridge.doctor.check import (
            as_json,  # imported here, because most consoles never run the doctor
            examine,
        )
        from bridge.doctor.checks import CHECKS
        from bridge.doctor.examination import context_from  # see above

        file = config_file(self._client.config)
        secrets = Secrets()
        with contextlib.suppress(ConfigError, yaml.YAMLError, RecursionError):
            secrets = secrets_of(text_of(file)) if file is not None else secrets
        reports = examine(context_from(self._client, file), CHECKS)
        return [{key: secrets.hide(text) for key, text in entry.items()} for entry in as_json(reports)]


def inspection_verbs(client: Client, log: LogFollower) -> dict[str, PageVerb]:
    """Return the verbs by name."""

    def config() -> dict[str, Any]:
        return show_config(client.config)

    filters = {"after": _number, "level": _level, "worker": _text, "text": _text}
    return {
        "log": PageVerb(log.read, {}, filters, commands=False),
        "doctor": PageVerb(Doctor(client), {}, {}, commands=False, slow=True),
        "config": PageVerb(config, {}, {}, commands=False, slow=True),
    }


def _number(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**53:
        raise ValueError("must be a line number")
    return value


def _level(value: Any) -> str:
    if value not in LEVELS:
        raise ValueError(f"must be one of {', '.join(LEVELS)}")
    return str(value)


def _text(value: Any) -> str:
    if not isinstance(value, str) or len(value) > _MOST_TEXT:
        raise ValueError(f"must be a text of up to {_MOST_TEXT} characters")
    return value
