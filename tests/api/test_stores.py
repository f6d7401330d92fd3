"""An opened store: its sessions and items, and the same answers as the command's."""

import subprocess
import sys
from pathlib import Path

import pytest

import lightstage
from tests.api.conftest import Command
from tests.conftest import REPOSITORY


def test_opening_a_store_makes_none(store: lightstage.OpenStore, sphere: Path) -> None:
    assert store.sessions == []
    assert not store.root.exists()
    with pytest.raises(lightstage.RequestError, match="no session 'x' in the store"):
        store.session("x")
    done = store.import_capture(sphere, "face")
    assert (done.new, done.session.name, store.sessions) == (True, "face", ["face"])
    assert "face" in repr(store)
    assert "frame 7" in repr(done.session)
    assert not store.import_capture(sphere, "face").changes


def test_the_command_and_the_api_answer_each_other(ball: lightstage.OpenSession, command: Command) -> None:
    answer = ball.run("normals", method="ratio")
    assert {name: node.computed for name, node in answer.nodes.items()} == {
        "register": 7,
        "split": 7,
        "stack": 7,
        "align": 1,
        "normals": 1,
    }
    said = command("run", "normals", "--session", "ball", "--set", "normals.method=ratio", "--json").json["nodes"]
    assert {name: node["computed"] for name, node in said.items()} == dict.fromkeys(said, 0)
    assert {name: node["path"] for name, node in said.items()} == {
        name: str(node.path) for name, node in answer.nodes.items()
    }
    assert ball.run("normals", set={"normals.method": "ratio"}).nodes["normals"].reused == 1


def test_importing_the_package_is_light_and_asks_for_one_thread() -> None:
    code = (
        "import sys, os\nbefore = set(sys.modules)\nimport lightstage\n"
        "assert os.environ['OPENBLAS_NUM_THREADS'] == '1'\n"
        "heavy = {'numpy', 'pydantic', 'yaml', 'xarray', 'zarr', 'dask'}\n"
        "assert not heavy & {name.split('.')[0] for name in sys.modules}\n"
        "assert not {name for name in sys.modules if name.startswith(('lightstage.api', 'lightstage.dag'))}\n"
        "assert set(lightstage.__all__) <= set(dir(lightstage))\n"
        "for name in lightstage.__all__:\n    getattr(lightstage, name)\n"
        "lightstage.open_store('nowhere')\n"
        "assert not heavy & {name.split('.')[0] for name in sys.modules}\n"
        "try:\n    lightstage.opne_store\nexcept AttributeError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, timeout=60)
    assert done.stdout == "module 'lightstage' has no attribute 'opne_store'\n", done.stderr


def test_an_items_users_are_the_sessions_that_are_bound_to_it(store: lightstage.OpenStore, sphere: Path) -> None:
    for name in ("a", "b"):
        store.import_capture(sphere, name)
    users = {item.kind: item.sessions for item in store.items()}
    assert users == {"homography": ("a", "b"), "bands": ("a", "b")}
    assert store.remove("a") > 0
    assert {item.sessions for item in store.items()} == {("b",)}


def test_what_nothing_uses_is_freed_and_the_rest_is_whole(store: lightstage.OpenStore, sphere: Path) -> None:
    store.import_capture(sphere)
    assert store.gc(grace_s=0).chunks == 0
    store.remove("ball")
    assert store.gc(grace_s=0, dry_run=True).chunks == store.gc(grace_s=0).chunks == 14
    assert store.verify().damaged == []
