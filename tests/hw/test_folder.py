"""A folder appears whole, or not at all."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from lightstage.hw.errors import RigError
from lightstage.hw.folder import appearing, dump, plain, save


def write_a(work: Path) -> None:
    (work / "a").write_text("1")


def refuse(work: Path) -> None:
    raise AssertionError("nothing is to be written")


def test_it_appears_with_a_note_of_what_it_holds(tmp_path: Path) -> None:
    folder = appearing(tmp_path / "deep" / "shot", {"seed": np.int64(3)}, write_a)
    assert sorted(p.name for p in folder.iterdir()) == ["a", "virtual_rig.yaml"]
    assert yaml.safe_load((folder / "virtual_rig.yaml").read_text()) == {"seed": 3}
    assert folder.stat().st_mode & 0o777 == 0o755


def test_the_same_again_writes_nothing_and_something_else_is_refused(tmp_path: Path) -> None:
    folder = appearing(tmp_path / "shot", {"seed": 3}, write_a)
    assert appearing(folder, {"seed": 3}, refuse) == folder
    with pytest.raises(RigError, match="shot holds something else; remove it"):
        appearing(folder, {"seed": 4}, refuse)
    assert (folder / "a").read_text() == "1"


@pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt])
def test_a_failure_leaves_nothing(tmp_path: Path, kind: type[BaseException]) -> None:
    def fail(work: Path) -> None:
        write_a(work)
        raise kind

    with pytest.raises(kind):
        appearing(tmp_path / "shot", {}, fail)
    assert list(tmp_path.iterdir()) == []


def test_numbers_of_numpy_become_plain() -> None:
    value: Any = plain({"a": np.array([[1, 2]]), "b": (np.float64(0.5), [np.bool_(True)]), "c": "text"})
    assert value == {"a": [[1, 2]], "b": [0.5, [True]], "c": "text"}
    assert [type(x) for x in (value["a"][0][0], value["b"][0], value["b"][1][0])] == [int, float, bool]


def test_documents_and_pictures_come_back(tmp_path: Path) -> None:
    dump(tmp_path / "x.yaml", {"b": [1, 2], "a": np.float64(0.25)})
    assert (tmp_path / "x.yaml").read_text() == "b: [1, 2]\na: 0.25\n"  # in the order given
    picture = np.array([[0, 1023], [65535, 7]], np.uint16)
    save(tmp_path / "p.png", picture)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "p.png"), cv2.IMREAD_UNCHANGED), picture)
    with pytest.raises(RigError, match=r"p\.png cannot be written; is the disk full\?"):
        save(tmp_path / "nowhere" / "p.png", picture)
