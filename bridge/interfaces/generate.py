"""Runs ROS 2's own generators for one package, as a program that `bridge.interfaces.builder` starts.

The generators write to standard output, replace it, and read the environment, so they must not run in a worker.
Usage: ``python generate.py REQUEST.json``, where the request is a `Request` as JSON. The program calls the functions of
Jazzy's rosidl packages (4.6) in the same way as the command-line tools of these packages.
"""

from __future__ import annotations

import json
import multiprocessing
import sys
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypedDict


class Request(TypedDict):
    """What to generate."""

    package: str
    files: list[str]  #: the package's definitions, as ``msg/Name.msg``
    source: str  #: folder of the definitions
    share: str  #: folder for the ``.idl`` and ``.json`` files
    roots: dict[str, str]  #: output folder of each generator, by its name
    resources: dict[str, str]  #: folder of each generator's templates, by its name
    known: dict[str, str]  #: ``share`` folder of each package that may be referred to, by its name
    jobs: int  #: number of processes to use


TYPESUPPORTS = ["rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"]


def main() -> None:
    """Translate the definitions to IDL, hash them, and run each generator."""
    request: Request = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    _parse_each_file_once()
    _translate(request)
    _hash(request)
    for generator in request["roots"]:
        _visibility(request, generator)
    # the children inherit the parsed files; most of the time goes into expanding the templates
    with multiprocessing.get_context("fork").Pool(request["jobs"]) as pool:
        pool.map(partial(_generate, request), request["roots"], chunksize=1)


def _parse_each_file_once() -> None:
    """Share the (slow) parser's result for a file among all generators; none of them changes it."""
    from rosidl_parser import parser

    parse: Callable[[Any], Any] = parser.parse_idl_file
    by_path = lru_cache(maxsize=None)(lambda locator_path, base: parse(_locator(base, locator_path)))
    parser.parse_idl_file = lambda locator: by_path(str(locator.relative_path), str(locator.basepath))


def _locator(base: str, relative: str) -> Any:
    from rosidl_parser.definition import IdlLocator

    return IdlLocator(base, relative)


def _idl(file: str) -> str:
    return Path(file).with_suffix(".idl").as_posix()


def _translate(request: Request) -> None:
    from rosidl_adapter.action import convert_action_to_idl
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_adapter.srv import convert_srv_to_idl

    convert = {".msg": convert_msg_to_idl, ".srv": convert_srv_to_idl, ".action": convert_action_to_idl}
    for name in request["files"]:
        file = Path(name)
        convert[file.suffix](Path(request["source"]), request["package"], file, Path(request["share"]) / file.parent)


def _hash(request: Request) -> None:
    from rosidl_generator_type_description import generate_type_hash

    known = [f"{package}:{share}" for package, share in request["known"].items()]
    generate_type_hash(_arguments(request, "hash", output_dir=request["share"], include_paths=known))


def _visibility(request: Request, generator: str) -> None:
    """Expand the header that decides which symbols a library exports, if the generator has one."""
    name = f"{generator}__visibility_control.h"
    template = Path(request["resources"][generator]) / f"{name}.in"
    if template.is_file():
        text = template.read_text(encoding="utf-8")
        text = text.replace("@PROJECT_NAME@", request["package"])
        text = text.replace("@PROJECT_NAME_UPPER@", request["package"].upper())
        header = Path(request["roots"][generator]) / request["package"] / "msg" / name
        header.parent.mkdir(parents=True, exist_ok=True)
        header.write_text(text, encoding="utf-8")


def _generate(request: Request, generator: str) -> None:
    import rosidl_generator_c
    import rosidl_typesupport_c
    import rosidl_typesupport_fastrtps_c
    import rosidl_typesupport_introspection_c
    from rosidl_generator_py.generate_py_impl import generate_py

    share = Path(request["share"])
    descriptions = {
        "type_description_tuples": [f"{_idl(f)}:{share / Path(f).with_suffix('.json')}" for f in request["files"]],
        "ros_interface_files": [str(Path(request["source"]) / f) for f in request["files"]],
    }
    run: dict[str, Callable[[str], Any]] = {
        "rosidl_generator_c": rosidl_generator_c.generate_c,
        "rosidl_generator_py": partial(generate_py, typesupport_impls=["rosidl_typesupport_c"]),
        "rosidl_typesupport_c": partial(rosidl_typesupport_c.generate_c, type_supports=TYPESUPPORTS),
        "rosidl_typesupport_fastrtps_c": rosidl_typesupport_fastrtps_c.generate_typesupport_fastrtps_c,
        "rosidl_typesupport_introspection_c": rosidl_typesupport_introspection_c.generate_c,
    }
    output = str(Path(request["roots"][generator]) / request["package"])
    template = request["resources"][generator]
    run[generator](_arguments(request, generator, output_dir=output, template_dir=template, **descriptions))


def _arguments(request: Request, name: str, **more: Any) -> str:
    """Write a generator's arguments file; return its path."""
    arguments = {
        "package_name": request["package"],
        "idl_tuples": [f"{request['share']}:{_idl(file)}" for file in request["files"]],
        "ros_interface_dependencies": [],
        "target_dependencies": [],
        **more,
    }
    path = Path(sys.argv[1]).with_name(f"{name}.json")
    path.write_text(json.dumps(arguments), encoding="utf-8")
    return str(path)


if __name__ == "__main__":
    main()
