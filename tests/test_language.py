"""The measure of language (scripts/language.py): which phrases and names count, and when a folder exceeds a limit."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from scripts import language


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("Return None where it is missing.", "where, for if"),
        ("The server tells its clients.", "tell"),
        ("A node that hears the topic.", "hear"),
        ("The log says so.", "say"),
        ("A map that is no image.", "is no"),
        ("Wait if there is no master.", "there is no"),
        ("Each route has a queue of its own.", "of its own"),
        ("The name is of YARP's server.", "of somebody's"),
        ("Used by tests alone.", "alone, for only"),
        ("After so many seconds.", "so many"),
        ("Started anew.", "behind, beside"),
        ("It is needed no more.", "no more, for no longer"),
        ("A file taken for a map.", "take up"),
        ("Nobody waits; somebody calls.", "nobody"),
        ("Each side has its way.", "way, for path or method"),
        ("Closed by the client; who calls again waits.", "who, without a noun"),
    ],
)
def test_each_phrase_counts_in_a_docstring(text: str, name: str) -> None:
    count = language.of_source(f'"""{text.lower()}"""\n')
    assert count.phrases[name] >= 1


@pytest.mark.parametrize(
    "text",
    [
        "The file is no longer there.",
        "The folder where maps are stored.",
        "A client whose lease expires reconnects.",
        "The route that was removed.",
    ],
)
def test_plain_sentences_do_not_count(text: str) -> None:
    assert language.of_texts([text]).phrases.total() == 0


def test_comments_and_messages_count_but_not_identifiers_directives_or_short_strings() -> None:
    source = '# nobody waits\nraise ValueError("a name told to nobody")\nnobody["told"]  # noqa: told\n'
    assert +language.of_source(source).phrases == {"nobody": 2, "tell": 1}


def test_code_in_a_page_does_not_count(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "page.md").write_text("Call `told()`.\n\n```python\n# nobody told\n```\n\nNobody is heard.\n")
    (tmp_path / "README.md").write_text("Told.\n")
    pages = language.measure(tmp_path)[language.PAGES]
    assert {path.name: count.phrases.total() for path, count in pages.items()} == {"page.md": 2, "README.md": 1}


def test_the_pages_of_every_folder_count(tmp_path: Path) -> None:
    pages = ["README.md", "benchmarks/README.md", "examples/README.md", "bridge/messages/definitions/README.md"]
    for page in pages:
        (tmp_path / page).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / page).write_text("Nobody waits.\n")
    counts = language.measure(tmp_path)[language.PAGES]
    assert {str(path.relative_to(tmp_path)): count.phrases.total() for path, count in counts.items()} == dict.fromkeys(
        pages, 1
    )


@pytest.mark.parametrize(
    ("file", "source"),
    [
        ("configs/nav2.yaml", "# nobody waits\nname: 'nobody # waits'\n"),
        ("packaging/midspan.service", "# nobody waits\nExecStart=nobody\n"),
        ("pyproject.toml", "[nobody]  # nobody waits\n"),
        ("bridge/web/static/app.js", 'import { say } from "../../lib/say.js"; // nobody waits\nsay(nobody);\n'),
        ("bridge/web/static/lib/a.js", 'say("Nobody waits for it.");\n'),
        ("bridge/adapters/ros2/taking.c", '/* nobody\n waits */\nint nobody = 0; char *url = "//nobody";\n'),
    ],
)
def test_comments_and_messages_of_other_files_count(tmp_path: Path, file: str, source: str) -> None:
    (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / file).write_text(source)
    measured = language.measure(tmp_path)
    assert sum((language.total(counts.values()).phrases for counts in measured.values()), Counter()) == {"nobody": 1}


def test_vague_names_count_with_a_leading_underscore_too() -> None:
    count = language.of_source("def _take(found):\n    _said = found\n    for each in _said: pass\ndef accept(): ...\n")
    assert (count.functions, count.vague_functions) == (2, 1)
    assert (count.variables, count.vague_variables) == (2, 2)


def test_a_folder_above_a_limit_is_listed_with_its_worst_file(tmp_path: Path) -> None:
    (tmp_path / "sim").mkdir()
    (tmp_path / "sim" / "good.py").write_text('"""' + "The robot drives to the goal. " * 200 + '"""\n')
    (tmp_path / "sim" / "bad.py").write_text("# nobody tells\n" * 4 + "found = 1\n" * 301)
    wrong = language.wrong(language.measure(tmp_path), tmp_path)
    assert [line.split(";")[0] for line in wrong] == [
        "sim: 6.6 phrases per 1,000 words, at most 4",
        "sim: 100.0 % of assignments with a vague name, at most 1",
    ]
    assert all("first in sim/bad.py, sim/good.py" in line for line in wrong)


def test_one_phrase_in_a_small_folder_exceeds_no_limit(tmp_path: Path) -> None:
    (tmp_path / "sim").mkdir()
    (tmp_path / "sim" / "a.py").write_text("# nobody tells\nfound = 1\n")
    assert language.wrong(language.measure(tmp_path), tmp_path) == []
