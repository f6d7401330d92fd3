"""Opening a store: what it is, which one it is, and what cannot be one."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from lightstage.store import marker
from lightstage.store.errors import RequestError
from lightstage.store.marker import FORMAT, Marker
from lightstage.store.root import Store
from lightstage.store.sealed import seal
from tests.conftest import REPOSITORY


def test_a_store_keeps_its_id_wherever_it_is(store: Store, tmp_path: Path) -> None:
    assert len(store.id) == 32
    store.scratch.leave()
    store.root.rename(tmp_path / "moved")
    assert Store(tmp_path / "moved").id == store.id
    assert Store(tmp_path / "another").id != store.id


def test_two_that_make_it_at_once_get_one_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first: list[Store] = []
    real = Marker.new

    def meanwhile() -> Marker:
        monkeypatch.setattr(Marker, "new", real)
        first.append(Store(tmp_path / "store"))
        return real()

    monkeypatch.setattr(Marker, "new", meanwhile)
    assert Store(tmp_path / "store").id == first[0].id


def test_looking_makes_no_store(tmp_path: Path) -> None:
    assert Store(tmp_path / "store", create=False).id == ""
    assert not (tmp_path / "store").exists()


OTHERS: dict[str, tuple[bytes, str]] = {
    "older": (
        json.dumps({"format": "lightstage-store/1"}).encode(),
        r"older lightstage \(format 1; .* `lightstage up",
    ),
    "newer": (
        seal({"format": f"lightstage-store/{FORMAT + 1}"}),
        rf"newer .*\(format {FORMAT + 1}\); this .* {FORMAT}$",
    ),
    "upgrading": (Marker(1, "", upgrading=True).as_bytes(), "`lightstage upgrade` goes on"),
    "flipped": (Marker.new().as_bytes().replace(b'"id":"', b'"id":"0'), "is damaged; `lightstage upgrade`"),
    "empty": (b"", "is damaged"),
    "deep": (b"[" * 100_000, "is damaged"),
    "odd": (b'{"format": "lightstage-store/two"}', "is damaged"),
    "another": (b'{"format": "somebody-else/1"}', "says 'somebody-else/1'"),
}


@pytest.mark.parametrize(("data", "said"), OTHERS.values(), ids=OTHERS)
def test_a_store_of_another_format_says_what_to_do(data: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / marker.NAME).write_bytes(data)
    with pytest.raises(RequestError, match=said):
        Store(tmp_path)
    assert (tmp_path / marker.NAME).read_bytes() == data


def test_names_that_cannot_be_a_store(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "file").write_bytes(b"")
    for name, said in {
        "": "is empty",
        "a\0b": "NUL",
        "s3://bucket": "only a local folder",
        str(tmp_path / "loop"): "links to itself",
        str(tmp_path / "file"): "is a file",
        str(tmp_path / "file" / "store"): "no folder can be made",
        "x" * 5000: "too long a name",
    }.items():
        with pytest.raises(RequestError, match=said) as caught:
            Store(name)
        assert len(str(caught.value)) < 700


def test_a_store_in_a_removed_working_folder_is_a_sentence(tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    code = (
        f"import os, sys; sys.path.insert(0, {str(REPOSITORY)!r}); os.rmdir({str(gone)!r})\n"
        "from lightstage.store.root import Store\nfrom lightstage.store.errors import RequestError\n"
        "try: Store('data')\nexcept RequestError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=gone, capture_output=True, text=True, check=False)
    assert "the working folder has been removed" in done.stdout, done.stderr


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_a_store_of_another_user_is_a_sentence(store: Store, tmp_path: Path) -> None:
    os.chmod(store.root, 0o700)
    for folder in (tmp_path, *tmp_path.parents):
        if folder != Path("/") and folder != Path("/tmp"):
            os.chmod(folder, os.stat(folder).st_mode | 0o011)
    child = os.fork()
    if child == 0:
        os.setresuid(65534, 65534, 65534)
        try:
            Store(store.root)
        except RequestError as error:
            os._exit(0 if "Permission denied" in str(error) else 1)
        finally:
            os._exit(2)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
