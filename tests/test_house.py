"""What scripts/house.py finds: cycles, duplicate class names, large files. `make lint` checks the tree itself."""

from __future__ import annotations

from pathlib import Path

from scripts import house


def write(folder: Path, files: dict[str, str]) -> dict[str, house.File]:
    for part in house.PRODUCT:
        (folder / part).mkdir()
        (folder / part / "__init__.py").write_text("")
    for name, text in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    return house.read(folder)


def test_a_cycle_that_is_hidden_in_a_function_is_found(tmp_path: Path) -> None:
    files = write(
        tmp_path,
        {
            "sim/a.py": "from sim.b import f\n",
            "sim/b.py": "def f():\n    from sim import c\n    return c\n",
            "sim/c.py": "import sim.a\n",
            "sim/d.py": "from sim.a import f\n",
        },
    )
    assert house.cycles(house.imports(files)) == [["sim.a", "sim.b", "sim.c"]]


def test_a_reexported_name_counts_for_the_file_that_defines_it(tmp_path: Path) -> None:
    files = write(
        tmp_path,
        {
            "bridge/hub/__init__.py": "from bridge.hub.session import Hub\n",
            "bridge/hub/session.py": "from bridge.routing import loop\nclass Hub: ...\n",
            "bridge/routing/__init__.py": "",
            "bridge/routing/loop.py": "from bridge.hub import Hub\n",
        },
    )
    graph = house.imports(files)
    assert graph["bridge.routing.loop"] == {"bridge.hub.session"}
    assert house.cycles(graph) == [["bridge.hub.session", "bridge.routing.loop"]]
    assert house.package_cycles(files, graph) == [["bridge.hub", "bridge.routing"]]


def test_classes_with_the_same_name_are_found(tmp_path: Path) -> None:
    files = write(tmp_path, {"sim/a.py": "class One: ...\n", "sim/b.py": "class One: ...\nclass _Two: ...\n"})
    assert house.shared_classes(files) == {"One": ["sim.a", "sim.b"]}


def test_private_access_and_tests_without_an_assertion_are_found(tmp_path: Path) -> None:
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_a.py").write_text(
        "from a import _b\n"
        "def test_a():\n    assert self._a + one._b + super()._c + one._replace() + one.__dict__\n"
        "def test_b():\n    one.until_seen()\n"
        "def test_c():\n    wait(lambda: one.check)\n"
        "def test_d():\n    with pytest.raises(ValueError):\n        one()\n"
    )
    assert house.private_accesses(tmp_path) == 2
    assert house.assertless(tmp_path) == ["tests/test_a.py:6 test_c"]


def test_large_files_and_stale_exceptions_for_them_are_reported(tmp_path: Path) -> None:
    files = write(tmp_path, {"sim/a.py": "x = 1\n" * (house.LARGE + 1)})
    assert house.wrong(files, known_large={"sim.b"}) == [
        f"{tmp_path}/sim/a.py: {house.LARGE + 1} lines, at most {house.LARGE}",
        "sim.b is not a large file; remove it from KNOWN_LARGE",
    ]
    assert house.wrong(files, known_large={"sim.a"}) == []


def test_public_functions_need_a_docstring_except_those_that_register_or_run_a_verb(tmp_path: Path) -> None:
    names = ("register", "register_top", "run", "run_top", "_go", "show", "runs")
    files = write(tmp_path, {"sim/a.py": "".join(f"def {name}(): ...\n" for name in names)})
    assert house.wrong(files, known_large=set()) == [
        f"{tmp_path}/sim/a.py:6: show needs a docstring", f"{tmp_path}/sim/a.py:7: runs needs a docstring",
    ]  # fmt: skip


def test_public_methods_need_a_docstring_except_overriding_ones_properties_and_names_like_close(tmp_path: Path) -> None:
    methods = "    def close(self): ...\n    @override\n    def run(self): ...\n    def _go(self): ...\n"
    methods += "    @property\n    def state(self): ...\n    def clear(self): ...\n"
    text = f"class One:\n{methods}    def send(self): ...\nclass _Two:\n    def send(self): ...\n"
    files = write(tmp_path, {"sim/a.py": text, "sim/b.py": f"# ruff: noqa: N802, D102 - YARP's\n{text}"})
    assert house.wrong(files, known_large=set()) == [f"{tmp_path}/sim/a.py:9: One.send needs a docstring"]
