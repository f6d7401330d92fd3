"""What a module's code is: what counts, what does not, and what is remembered of it."""

import ast
import importlib
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest

from lightstage import compiled
from lightstage.dag import code, sources
from lightstage.dag.code import code_digest, module_code, module_libraries

CODE = '''
"""A stage."""
import numpy as np

LIMIT = 3  # pixels

def kernel(a, *, sigma: float = 1.0):
    """Smooth."""
    # a comment
    return np.sqrt(a) * sigma + LIMIT
'''


@pytest.mark.parametrize(
    "edited",
    [
        CODE.replace("# a comment", "# another"),
        CODE.replace('"""Smooth."""', '"""Smooth a lot.\n\n    More.\n    """'),
        CODE.replace("sigma: float = 1.0", "sigma: 'np.float64' = 1.0"),
        CODE.replace("np.sqrt(a) * sigma + LIMIT", "(\n        np.sqrt(a)\n        * sigma\n    ) + LIMIT"),
        CODE.replace("  # pixels", '\n"""How far."""'),
    ],
)
def test_comments_formatting_docstrings_and_annotations_do_not_count(edited: str) -> None:
    assert edited != CODE
    assert code_digest(edited) == code_digest(CODE)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("sqrt", "cbrt"),
        ("1.0", "1.5"),
        ("LIMIT = 3", "LIMIT = 4"),
        ("* sigma", "/ sigma"),
        ("import numpy", "import cupy"),
    ],
)
def test_what_can_change_numbers_counts(old: str, new: str) -> None:
    assert code_digest(CODE.replace(old, new)) != code_digest(CODE)


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package of three modules that import each other, and nothing remembered of it."""
    folder = tmp_path / "fakestages"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "top.py").write_text("from fakestages import middle\nfrom lightstage.dag.stage import Params\n")
    (folder / "middle.py").write_text("from .bottom import f\nimport scipy.ndimage\n")
    (folder / "bottom.py").write_text("def f(a):\n    return a\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "compiled"))
    importlib.invalidate_caches()
    another_process()
    yield folder
    another_process()


def another_process() -> None:
    """Forget what only this process knows."""
    for remembered in (code._module_code, code._is_module, code._memory, compiled._first_writable):
        remembered.cache_clear()


def test_helpers_count_also_through_others(package: Path) -> None:
    before = dict(module_code(["fakestages.top"]))
    assert set(before) == {"fakestages.top", "fakestages.middle", "fakestages.bottom"}
    assert list(module_libraries(["fakestages.top"])) == ["scipy"]
    (package / "bottom.py").write_text("def f(a):\n    return a + 1\n")
    code._module_code.cache_clear()
    after = dict(module_code(["fakestages.top"]))
    assert {name for name in after if after[name] != before[name]} == {"fakestages.bottom"}


def test_several_roots_count_together_and_are_not_imported(package: Path) -> None:
    assert set(module_code(["fakestages.bottom", "fakestages.middle"])) == {
        "fakestages.middle",
        "fakestages.bottom",
    }
    assert not [name for name in sys.modules if name.startswith("fakestages")]


def test_what_was_found_is_not_parsed_again(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another process knows a text's code from the file, a new text it has to parse; the answers are the same."""
    before = dict(module_code(["fakestages.top"]))
    code.keep_memory()
    parsed: list[bytes] = []
    real = compiled.parsed
    monkeypatch.setattr(compiled, "parsed", lambda text: (parsed.append(text), real(text))[1])
    another_process()
    assert module_code(["fakestages.top"]) == before
    assert parsed == []
    (package / "bottom.py").write_text("def f(a):\n    return a + 1\n")
    another_process()
    assert module_code(["fakestages.top"])["fakestages.bottom"] != before["fakestages.bottom"]
    assert set(parsed) == {b"def f(a):\n    return a + 1\n"}


@pytest.mark.parametrize("harm", ["a flipped bit", "half of it", "nothing in it", "another's", "no folder"])
def test_a_memory_that_is_damaged_is_not_believed(
    package: Path, tmp_path: Path, harm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = dict(module_code(["fakestages.top"]))
    code.keep_memory()
    (file,) = (tmp_path / "compiled").glob("code-*.json")
    data = file.read_bytes()
    if harm == "a flipped bit":
        middle = len(data) // 2
        file.write_bytes(data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :])
    elif harm == "another's":
        monkeypatch.setattr("os.geteuid", lambda: 12345)
    elif harm == "no folder":
        monkeypatch.setattr(compiled, "folder", lambda: None)
    else:
        file.write_bytes(data[: len(data) // 2] if harm == "half of it" else b"")
    another_process()
    assert module_code(["fakestages.top"]) == before
    code.keep_memory()


def test_what_is_remembered_is_of_what_was_executed(package: Path) -> None:
    """An edit after the import is not what this process computes with, whatever the file's memory says of it."""
    module_code(["fakestages.top"])
    sources._executed["fakestages.bottom"] = b"def f(a):\n    return a\n"
    try:
        (package / "bottom.py").write_text("def f(a):\n    return a + 1\n")
        code._module_code.cache_clear()
        found = module_code(["fakestages.top"])["fakestages.bottom"]
        assert found == code_digest("def f(a):\n    return a\n")
    finally:
        del sources._executed["fakestages.bottom"]


def test_a_type_alias_or_decorator_is_code() -> None:
    plain = textwrap.dedent("def f(a):\n    return a\n")
    assert code_digest("@njit\n" + plain) != code_digest(plain)
    assert code_digest("@njit(fastmath=True)\n" + plain) != code_digest("@njit\n" + plain)


def test_parsing_that_fails_because_of_another_thread_is_done_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fault of Python 3.11.7 and 3.12.1: the depth of the recursion is counted for all threads together."""
    real, failures = ast.parse, iter([SystemError("AST constructor recursion depth mismatch")] * 3)

    def parse(text: bytes) -> ast.AST:
        failure = next(failures, None)
        if failure is not None:
            raise failure
        return real(text)

    monkeypatch.setattr(ast, "parse", parse)
    assert ast.dump(compiled.parsed(b"a = 1")) == ast.dump(real(b"a = 1"))
