"""SROS 2: the enclave of the side's participant, and why it cannot join a secured domain.

rcl reads these variables when it creates the context (rcl, security.c). With the strategy Permissive the participant
would join unsecured if its enclave is missing, so the enclave is checked for both strategies.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

ENABLE = "ROS_SECURITY_ENABLE"
_KEYSTORE, _OVERRIDE = "ROS_SECURITY_KEYSTORE", "ROS_SECURITY_ENCLAVE_OVERRIDE"
_ENCLAVE = "/midspan"


def enclave(environ: Mapping[str, str]) -> dict[str, str]:
    """Return the variable that gives a worker in a secured domain its own enclave; a value that is set is kept."""
    return {_OVERRIDE: environ.get(_OVERRIDE) or _ENCLAVE} if is_enabled(environ) else {}


def is_enabled(environ: Mapping[str, str]) -> bool:
    """Return whether the programs of an environment join secured domains; rcl accepts only ``true``."""
    return environ.get(ENABLE) == "true"


def trouble(environ: Mapping[str, str], *, wheels: bool) -> str:
    """Return why the side cannot join a secured domain, and the cure; "" if it can, or if none is wanted.

    With ``wheels`` Fast DDS comes from the wheels, which are built without DDS Security.
    """
    if not is_enabled(environ):
        return ""
    if wheels:
        return (
            f"{ENABLE} is true, but the Fast DDS of the wheels is built without DDS Security; source an installed"
            f" ROS 2, which has it, before Midspan's daemon starts, or unset {ENABLE}"
        )
    keystore, name = environ.get(_KEYSTORE, ""), enclave(environ)[_OVERRIDE]
    if not keystore:
        return f"{ENABLE} is true, but {_KEYSTORE} is not set; set it to the folder that 'ros2 security' created"
    if not (Path(keystore) / "enclaves" / name.strip("/")).is_dir():
        return f"the keystore {keystore} has no enclave {name}; 'ros2 security create_enclave {keystore} {name}'"
    return ""
