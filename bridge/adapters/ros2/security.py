"""SROS 2: the enclave of the side's participant, and why it cannot join a secured domain.

rcl reads these variables when it creates the context (rcl, security.c). With the strategy Permissive the participant
would join unsecured if its enclave is missing, so the enclave is checked for both strategies.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from bridge.adapters.ros2 import enclave_files
from bridge.adapters.ros2.enclave_files import AUTHORITIES, GOVERNANCE, EnclaveError

ENABLE = "ROS_SECURITY_ENABLE"
KEYSTORE, OVERRIDE = "ROS_SECURITY_KEYSTORE", "ROS_SECURITY_ENCLAVE_OVERRIDE"
_ENCLAVE = "/midspan"


def enclave(environ: Mapping[str, str]) -> dict[str, str]:
    """Return the variable that gives a worker in a secured domain its own enclave; a value that is set is kept."""
    return {OVERRIDE: environ.get(OVERRIDE) or _ENCLAVE} if is_enabled(environ) else {}


def is_enabled(environ: Mapping[str, str]) -> bool:
    """Return whether the programs of an environment join secured domains; rcl accepts only ``true``."""
    return environ.get(ENABLE) == "true"


def refusal(environ: Mapping[str, str]) -> str:
    """Return the likely cure if DDS refuses an endpoint in a secured domain; "" outside of one."""
    if not is_enabled(environ):
        return ""
    return f"allow it in the permissions of the enclave {enclave(environ)[OVERRIDE]} (ros2 security create_permission)"


def rejection(environ: Mapping[str, str], domain: int) -> str:
    """Return what to do if DDS does not create a participant with an enclave, for a reason that it only logs."""
    return (
        f"DDS did not join the secured domain, probably because it rejects the files in {_folder(environ)}; the log"
        " names the reason in the lines with SECURITY."
        f" To replace the files, remove the folder, then {_creation(environ, domain)}"
    )


def _folder(environ: Mapping[str, str]) -> Path:
    return Path(environ.get(KEYSTORE, "")) / "enclaves" / enclave(environ)[OVERRIDE].strip("/")


def _creation(environ: Mapping[str, str], domain: int) -> str:
    return f"'{_tool(domain)} create_enclave {environ.get(KEYSTORE, '')} {enclave(environ)[OVERRIDE]}'"


def trouble(environ: Mapping[str, str], domain: int, *, wheels: bool) -> str:
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
    keystore, name = environ.get(KEYSTORE, ""), enclave(environ)[OVERRIDE]
    if not keystore:
        return f"{ENABLE} is true, but {KEYSTORE} is not set; set it to the folder that 'ros2 security' created"
    if not name.startswith("/"):
        return f"{OVERRIDE} is {name}, but the name of an enclave begins with a slash; set it to /{name}"
    folder, create = _folder(environ), _creation(environ, domain)
    try:
        if not folder.is_dir():
            return f"the keystore {keystore} has no enclave {name}; {create}"
        enclave_files.check(folder, domain)
    except FileNotFoundError as err:
        return f"{err.filename} is missing; {create}"
    except OSError as err:
        reason = f"cannot read {err.filename or folder}: {err.strerror}"
        return f"{reason}; the user of Midspan's daemon needs read access to the enclave's files"
    except EnclaveError as err:
        again = f"remove {'the folder' if err.file == folder else 'it'}, then {create}"
        return f"{err}; {_replacement(err.file, Path(keystore), domain) or again}"
    return ""


def _tool(domain: int) -> str:
    return f"ROS_DOMAIN_ID={domain} ros2 security"


def _replacement(file: Path, keystore: Path, domain: int) -> str:
    """Return how to replace a file of the whole keystore; "" for a file of one enclave."""
    if file.name == GOVERNANCE:
        documents = f"governance.xml and {GOVERNANCE} in {keystore / 'enclaves'}"
        return f"remove {documents}, then '{_tool(domain)} create_keystore {keystore}'"
    if file.name in AUTHORITIES:
        return f"create a new keystore with new enclaves: '{_tool(domain)} create_keystore FOLDER'"
    return ""
