"""The sections of modules that can also be configured with a YARP file."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, ClassVar, Self

from typing_extensions import override

from bridge.config.sections.section import Mistake, ModuleSection, setting


class FileSection(ModuleSection):
    """The section of a module that may also read a YARP file, whose values the section's own keys override.

    Attributes:
        reader: the function that reads the file, as ``package.module:function``; see `navigation.ini.laid_under`.
        merged: the inner sections of which the file and the configuration may each set some keys.
    """

    reader: ClassVar[str]
    merged: ClassVar[tuple[str, ...]] = ()

    ini: Path | None = setting(None, "A YARP file of an existing robot; keys set here override it.")

    @override
    def mistakes(self, config: Any) -> Iterable[Mistake]:
        if self.ini is None:
            return self.misfits()
        from navigation.ini import mistakes_with_file  # imports YARP's data

        return mistakes_with_file(self, self.ini, resolve_name(self.reader), type(self).misfits, merged=self.merged)

    @override
    def named_files(self) -> Iterable[Path]:
        if self.ini is None:
            return ()
        from navigation.ini import files_of  # as in `mistakes`

        return files_of(self.ini)

    def with_file(self) -> Self:
        """Return the section with its file's values as defaults; unchanged if the file is invalid."""
        if self.ini is None:
            return self
        from navigation.ini import laid_under  # imports YARP's data

        with suppress(RuntimeError):  # the module does not start, and reports it
            return laid_under(self, self.ini, resolve_name(self.reader), merged=self.merged)[0]
        return self

    def misfits(self) -> Iterable[Mistake]:
        """Return the keys that do not fit the others."""
        return ()
