"""The configuration in a worker's process: its sections are imported and built when they are first used.

The models of all sections take 0.1 s of processor time, and a worker uses few of them.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import PrivateAttr
from typing_extensions import override

from bridge.config.digests import set_digests
from bridge.config.model import FORMAT, Config, Default
from bridge.config.sections.section import DrivenTopic


class ReceivedConfig(Config):
    """A configuration that the daemon has checked, from the plain data that it sent."""

    _sent: dict[str, Any] = PrivateAttr()
    _digests: Mapping[str, str] = PrivateAttr()
    _driven: tuple[DrivenTopic, ...] | None = PrivateAttr()

    @classmethod
    def of(cls, data: dict[str, Any]) -> ReceivedConfig:
        """Return the configuration; a section raises `pydantic.ValidationError` at its first use if it is invalid."""
        state = data["state"]
        config = cls.__new__(cls)
        values = {"version": FORMAT, "name": data["name"], "state": None if state is None else Path(state)}
        sections = {name: value for name, value in data.items() if name not in values}
        # as `model_construct` does, which would create all sections
        object.__setattr__(config, "__dict__", values)
        object.__setattr__(config, "__pydantic_fields_set__", set(data))
        object.__setattr__(config, "__pydantic_extra__", None)
        object.__setattr__(
            config, "__pydantic_private__", {"_digest": "", "_sent": sections, "_digests": {}, "_driven": None}
        )
        return config

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Build a section at its first use."""
            private = self.__pydantic_private__ or {}
            if name not in private.get("_sent", ()):
                return super().__getattr__(name)
            factory = type(self).model_fields[name].default_factory
            model = factory.model if isinstance(factory, Default) else factory
            section = self.__dict__[name] = model.model_validate(private["_sent"][name])
            own = {key: digest for key, digest in self._digests.items() if key.partition(".")[0] == name}
            set_digests(self, own)
            return section

    @override
    def set_digests(self, values: Mapping[str, str]) -> None:
        self._digests = values

    @override
    def set_driven(self, topics: tuple[DrivenTopic, ...]) -> None:
        self._driven = topics

    @property
    @override
    def driven_topics(self) -> tuple[DrivenTopic, ...]:
        """The topics that move this robot; an earlier daemon does not send them, and then all sections are built."""
        return super().driven_topics if self._driven is None else self._driven

    def _build(self) -> None:
        for name in self._sent:
            getattr(self, name)

    @override
    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Config):
            return NotImplemented
        return dict(self) == dict(other)

    @override
    def __iter__(self) -> Generator[tuple[str, Any], None, None]:
        self._build()
        return super().__iter__()

    @override
    def model_dump(self, **options: Any) -> dict[str, Any]:
        self._build()
        return super().model_dump(**options)

    @override
    def model_dump_json(self, **options: Any) -> str:
        self._build()
        return super().model_dump_json(**options)
