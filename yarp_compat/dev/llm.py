"""A large language model at a port (`ILLMMsgs.thrift`, `ILLM.h`), and its client, like YARP's ``LLM_nwc_yarp``."""

# mypy: disable-error-code="empty-body"
# ruff: noqa: D102 - the names are those of YARP's .thrift file

from __future__ import annotations

from collections.abc import Iterable, MutableSequence
from dataclasses import dataclass, field
from typing import Unpack

from yarp_compat.dev.client import ClientOptions, ServiceClient
from yarp_compat.dev.fields import Generated
from yarp_compat.dev.returnvalue import ReturnValue, invoke, outcome_of
from yarp_compat.dev.service import Service, rpc
from yarp_compat.os.data.stdvector import StdVector


@dataclass
class LLM_Message(Generated):  # noqa: N801 - YARP's name
    """A message of a conversation: its author (``user``, ``assistant``, ``function``) and content."""

    type: str = ""
    content: str = ""
    parameters: list[str] = field(default_factory=list)
    arguments: list[str] = field(default_factory=list)


class LLMVector(StdVector):
    """A vector of messages."""

    def __init__(self, content: int | Iterable[LLM_Message] = ()) -> None:
        super().__init__((LLM_Message() for _ in range(content)) if isinstance(content, int) else content)


@rpc
class ILLMMsgs(Service):
    """The methods of a model's port."""

    def setPrompt(self, prompt: str) -> ReturnValue: ...
    def readPrompt(self) -> tuple[ReturnValue, str]: ...
    def ask(self, question: str) -> tuple[ReturnValue, LLM_Message]: ...
    def getConversation(self) -> tuple[ReturnValue, list[LLM_Message]]: ...
    def deleteConversation(self) -> ReturnValue: ...
    def refreshConversation(self) -> ReturnValue: ...


class ILLM:
    """The interface under YARP's names; as in C++, results are filled in (a text as the only element of a list)."""

    def __init__(self, remote: ILLMMsgs) -> None:
        self._remote = remote

    setPrompt = outcome_of(ILLMMsgs.setPrompt)
    deleteConversation = outcome_of(ILLMMsgs.deleteConversation)
    refreshConversation = outcome_of(ILLMMsgs.refreshConversation)

    def readPrompt(self, oPrompt: MutableSequence[str]) -> ReturnValue:
        """Store the prompt of the conversation in a list."""
        return invoke(self._remote.readPrompt, into=oPrompt)

    def ask(self, question: str, answer: LLM_Message) -> ReturnValue:
        """Ask a question and wait for the answer."""
        return invoke(self._remote.ask, question, into=answer)

    def getConversation(self, conversation: MutableSequence[LLM_Message]) -> ReturnValue:
        """Store all messages, from the prompt on, in a list."""
        return invoke(self._remote.getConversation, into=conversation)


class LLMClient(ServiceClient[ILLMMsgs]):
    """A client of a model's port; ``llm`` has the interface. By default replies have no timeout: models are slow."""

    def __init__(self, server: str, name: str = "", **options: Unpack[ClientOptions]) -> None:
        options.setdefault("timeout", None)
        super().__init__(ILLMMsgs, server, name, **options)
        self.llm = ILLM(self.remote)
