"""Changes of one session at once: each is made from what stands, and none is lost."""

import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from lightstage.store import importer, sessions
from lightstage.store.calibration import read_item
from lightstage.store.errors import WorkError
from lightstage.store.importer import import_capture
from lightstage.store.items import Item, put_item
from lightstage.store.root import Store
from lightstage.store.sessions import SessionChangedError, bind_item, commit_session, read_session, remove_session
from tests.scenes import one_camera_capture

TEXTS = {
    "bands": "item: bands\nbands: [{centre_nm: 0, exposure: 2}]\n",
    "polarisers": "item: polarisers\nlights: [{id: L00, angle_deg: 3, residual: 0}]\n",
    "lights": "item: lights\nlights: [{id: L00, direction: [0, 0, 1]}]\n",
    "homography": "item: homography\nfrom: CAM0\nto: CAM1\nmatrix: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return one_camera_capture(tmp_path / "c", ["C", "X", "Y", "Z"])


@pytest.fixture
def items(store: Store, tmp_path: Path) -> dict[str, Item]:
    made = {}
    for kind, text in TEXTS.items():
        path = tmp_path / f"{kind}.yaml"
        path.write_text(text)
        made[kind], original = read_item(path, store.chunks)
        put_item(made[kind], original, store)
    return made


def between(monkeypatch: pytest.MonkeyPatch, module: object, name: str, other: Callable[[], object]) -> None:
    """Let another command do its work when this one first calls a function."""
    function = getattr(module, name)
    waiting = [other]

    def held(*given: object, **named: object) -> object:
        if waiting:
            waiting.pop()()
        return function(*given, **named)

    monkeypatch.setattr(module, name, held)


def bound(store: Store) -> set[str]:
    return set(read_session("c", store).items)


def test_a_binding_made_during_another_stays(
    folder: Path, store: Store, items: dict[str, Item], monkeypatch: pytest.MonkeyPatch
) -> None:
    import_capture(folder, store)
    between(monkeypatch, sessions, "write_raw", lambda: bind_item("c", items["lights"], store))
    assert bind_item("c", items["bands"], store) is None
    assert bound(store) == {"bands", "lights"}


def test_bindings_of_all_kinds_at_once_stay(
    folder: Path, store: Store, items: dict[str, Item], monkeypatch: pytest.MonkeyPatch
) -> None:
    import_capture(folder, store)
    together = threading.Barrier(len(items))
    waited = threading.local()
    write_raw = sessions.write_raw

    def held(*given: object) -> None:
        if not hasattr(waited, "once"):
            waited.once = True
            together.wait(30)  # all have read the session, and none has written it
        write_raw(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(sessions, "write_raw", held)
    threads = [threading.Thread(target=bind_item, args=("c", item, store)) for item in items.values()]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert bound(store) == set(items)


def test_a_binding_made_during_an_import_of_a_changed_folder_stays(
    folder: Path, store: Store, items: dict[str, Item], monkeypatch: pytest.MonkeyPatch
) -> None:
    import_capture(folder, store)
    description = folder / "capture.yaml"
    description.write_text(description.read_text().replace("rig: york", "rig: leeds") + "\ncalibration: items\n")
    (folder / "items").mkdir()
    (folder / "items" / "bands.yaml").write_text(TEXTS["bands"])
    between(monkeypatch, importer, "_verdict", lambda: bind_item("c", items["lights"], store))
    done = import_capture(folder, store)
    assert bound(store) == {"bands", "lights"}
    assert read_session("c", store) == done.session
    assert "calibration item bands is new" in done.changes


def test_a_session_that_has_changed_is_not_replaced(folder: Path, store: Store, items: dict[str, Item]) -> None:
    first = import_capture(folder, store).session
    bind_item("c", items["bands"], store)
    with pytest.raises(SessionChangedError, match="was changed by another command"):
        commit_session(first, store, expected=first.digest)
    with pytest.raises(SessionChangedError):
        commit_session(first, store, expected=None)
    assert bound(store) == {"bands"}
    remove_session("c", store)
    with pytest.raises(SessionChangedError, match="was changed by another command"):
        commit_session(first, store, expected=first.digest)
    commit_session(first, store, expected=None)
    assert read_session("c", store) == first


def test_what_is_undone_leaves_what_was_bound_meanwhile(folder: Path, store: Store, items: dict[str, Item]) -> None:
    first = import_capture(folder, store).session
    bind_item("c", items["bands"], store)
    after = read_session("c", store)
    bind_item("c", items["lights"], store)
    sessions.restore_session(first, after, store)
    assert bound(store) == {"lights"}


def test_a_command_that_holds_the_session_is_waited_for_and_then_named(
    folder: Path, store: Store, items: dict[str, Item], monkeypatch: pytest.MonkeyPatch
) -> None:
    import_capture(folder, store)
    monkeypatch.setattr(sessions, "PATIENCE_S", 0.05)
    with (
        sessions._changing("c", store),
        pytest.raises(WorkError, match=r"another command has been changing session 'c' for 0\.05 s"),
    ):
        bind_item("c", items["bands"], store)
    assert bind_item("c", items["bands"], store) is None
