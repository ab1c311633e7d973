"""Errors that end a command."""

from __future__ import annotations


class CliError(Exception):
    """A command failed for a reason that a person can act on; its text is all that is shown."""
