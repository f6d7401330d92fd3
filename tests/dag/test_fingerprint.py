"""The keys. The literal digests pin the scheme: when one changes, every cache out there is worthless."""

import json
from pathlib import Path

import numpy as np
import pytest

from lightstage.dag.code import code_digest
from lightstage.dag.fingerprint import block_key, plain_context, recipe
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


def test_reads_keep_their_order_and_their_inputs_apart() -> None:
    keys = {
        block_key("s", "c", {"a": ["1", "2"]}),
        block_key("s", "c", {"a": ["2", "1"]}),
        block_key("s", "c", {"a": ["1"], "b": ["2"]}),
        block_key("s", "d", {"a": ["1", "2"]}),
        block_key("t", "c", {"a": ["1", "2"]}),
    }
    assert len(keys) == 5
