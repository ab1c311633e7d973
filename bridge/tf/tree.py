"""The tree of frames as text, as a Graphviz graph and as YAML."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator

from bridge.tf.errors import seconds
from bridge.tf.transform import FrameInfo


def as_text(frames: Iterable[FrameInfo]) -> str:
    """Return a line for each frame, indented below its parent; frames in loops come last, each once."""
    below, infos = _below(frames)
    lines: list[str] = []
    shown = set[str]()

    def show(top: str) -> None:
        waiting = [(top, 0)]
        while waiting:
            name, depth = waiting.pop()
            if name in shown:
                continue
            shown.add(name)
            lines.append("  " * depth + name + _remark(infos.get(name)))
            waiting.extend((child, depth + 1) for child in reversed(below.get(name, [])))

    for root in sorted(set(below) - set(infos)):
        show(root)
    for name in sorted(set(infos) - shown):
        if name not in shown:
            lines.append(f"loop, through {name}:")
            show(name)
    return "\n".join(lines)


def as_dot(frames: Iterable[FrameInfo]) -> str:
    """Return a Graphviz graph like that of view_frames, with an arrow from each parent to its child."""
    return "\n".join(["digraph G {", *_edges(frames), "}"])


def as_yaml(frames: Iterable[FrameInfo]) -> str:
    """Return the reply of the service ``tf2_frames``: the fields of tf2's allFramesAsYAML, which view_frames reads.

    As in tf2, a static frame's times are 0 and its rate is 10000.
    """
    parts = [_yaml(info) for info in sorted(frames, key=lambda info: info.name)]
    return "".join(parts) or "{}"


def _yaml(info: FrameInfo) -> str:
    newest, oldest = seconds(info.newest), seconds(info.oldest)
    fields = {
        "parent": _quoted(info.parent),
        "broadcaster": _quoted(info.authority or "no recorded authority"),
        "rate": f"{info.samples / max(newest - oldest, 0.0001):.3f}",
        "most_recent_transform": f"{newest:.3f}",
        "oldest_transform": f"{oldest:.3f}",
        "buffer_length": f"{newest - oldest:.3f}",
    }
    return f"{_quoted(info.name)}:\n" + "".join(f"  {name}: {value}\n" for name, value in fields.items())


def _edges(frames: Iterable[FrameInfo]) -> Iterator[str]:
    for info in sorted(frames, key=lambda info: info.name):
        label = f"authority: {info.authority}\n" + _times(info)
        yield f"{_quoted(info.parent)} -> {_quoted(info.name)}[label={_quoted(label)}];"
        for other in sorted(info.parents - {info.parent}):
            yield f"{_quoted(other)} -> {_quoted(info.name)}[style=dashed];"


def _below(frames: Iterable[FrameInfo]) -> tuple[dict[str, list[str]], dict[str, FrameInfo]]:
    infos = {info.name: info for info in frames}
    below: dict[str, list[str]] = {}
    for name in sorted(infos):
        below.setdefault(infos[name].parent, []).append(name)
    return below, infos


def _remark(info: FrameInfo | None) -> str:
    if info is None:
        return ""
    text = f"  ({_times(info)}, {info.authority or 'unknown publisher'})"
    if len(info.sources) > 1:
        sources = ", ".join(f"{s.authority or 'unknown publisher'} under {s.parent}" for s in info.sources)
        text += f"  SEVERAL SOURCES: {sources}"
    return text


def _times(info: FrameInfo) -> str:
    return "static" if info.static else f"{info.rate:.1f} Hz, newest {info.newest / 1e9:.3f} s"


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
