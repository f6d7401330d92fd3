"""The keys. The literal digests pin the scheme: when one changes, every cache out there is worthless."""

import ast
import json
import textwrap
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lightstage import compiled
from lightstage.dag import fingerprint
from lightstage.dag.fingerprint import block_key, code_digest, plain_context, recipe
from lightstage.dag.stage import CalibrationPicture
from lightstage.store.digest import digest_array, digest_value

PINNED = Path(__file__).with_name("pinned_digests.json")

CODE = '''
"""A stage."""
import numpy as np

LIMIT = 3  # pixels

def kernel(a, *, sigma: float = 1.0):
    """Smooth."""
    # a comment
    return np.sqrt(a) * sigma + LIMIT
'''


def subjects() -> dict[str, str]:
    context = {"white_level": 1023, "dark": CalibrationPicture("abc", lambda: None), "matrix": [[1.0, 0.5]]}
    return {
        "value": digest_value({"b": [1, 2.5, None, True], "a": "ü"}),
        "array": digest_array(np.arange(6, dtype=np.float32).reshape(2, 3)),
        "code": code_digest(CODE),
        "context": digest_value(plain_context(context)),
        "block": block_key("stage", "context", {"signal": ["one", "two"]}),
        "recipe": recipe("stage", ["b", "a", "a"], ["above"]),
    }


def test_the_scheme_is_pinned(request: pytest.FixtureRequest) -> None:
    found = subjects()
    if request.config.getoption("--golden"):
        PINNED.write_text(json.dumps(found, indent=1) + "\n")
    assert found == json.loads(PINNED.read_text())


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


def test_helpers_count_also_through_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "fakestages"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "top.py").write_text("from fakestages import middle\nfrom lightstage.dag.stage import Params\n")
    (package / "middle.py").write_text("from .bottom import f\nimport scipy.ndimage\n")
    (package / "bottom.py").write_text("def f(a):\n    return a\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    fingerprint._module_code.cache_clear()
    fingerprint._is_module.cache_clear()
    before = dict(fingerprint.module_code("fakestages.top"))
    assert set(before) == {"fakestages.top", "fakestages.middle", "fakestages.bottom"}
    assert list(fingerprint.module_libraries("fakestages.top")) == ["scipy"]
    (package / "bottom.py").write_text("def f(a):\n    return a + 1\n")
    fingerprint._module_code.cache_clear()
    after = dict(fingerprint.module_code("fakestages.top"))
    assert {name for name in after if after[name] != before[name]} == {"fakestages.bottom"}


def test_reads_keep_their_order_and_their_inputs_apart() -> None:
    keys = {
        block_key("s", "c", {"a": ["1", "2"]}),
        block_key("s", "c", {"a": ["2", "1"]}),
        block_key("s", "c", {"a": ["1"], "b": ["2"]}),
        block_key("s", "d", {"a": ["1", "2"]}),
        block_key("t", "c", {"a": ["1", "2"]}),
    }
    assert len(keys) == 5


def test_a_type_alias_or_decorator_is_code() -> None:
    plain = textwrap.dedent("def f(a):\n    return a\n")
    assert code_digest("@njit\n" + plain) != code_digest(plain)
    assert code_digest("@njit(fastmath=True)\n" + plain) != code_digest("@njit\n" + plain)


@pytest.mark.parametrize("parsed", [fingerprint._parsed, compiled._parsed])
def test_parsing_that_fails_because_of_another_thread_is_done_again(
    monkeypatch: pytest.MonkeyPatch, parsed: Callable[[bytes], ast.AST]
) -> None:
    """A fault of Python 3.11.7 and 3.12.1: the depth of the recursion is counted for all threads together."""
    real, failures = ast.parse, iter([SystemError("AST constructor recursion depth mismatch")] * 3)

    def parse(text: bytes) -> ast.AST:
        failure = next(failures, None)
        if failure is not None:
            raise failure
        return real(text)

    monkeypatch.setattr(ast, "parse", parse)
    assert ast.dump(parsed(b"a = 1")) == ast.dump(real(b"a = 1"))
