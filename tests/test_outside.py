"""What is written outside of the store and the folder that a command is given: compiled code, and nothing else.

And where not even that can be written, the work goes on.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lightstage import compiled
from tests.conftest import REPOSITORY
from tests.package import copy_package
from tests.scenes import sphere_capture


def contents(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir()}


def commands(*calls: tuple[str, ...], **options: object) -> subprocess.CompletedProcess[str]:
    """Several commands in one process."""
    code = "import sys; from lightstage.cli.main import main; "
    code += f"sys.exit(max(main(list(words)) for words in {calls!r}))"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, **options)  # type: ignore[call-overload,no-any-return]


def plain_environment(**more: str) -> dict[str, str]:
    """The environment of somebody who has set nothing."""
    ours = ("MPLCONFIGDIR", "XDG_", "NUMBA_", "LIGHTSTAGE_", "HOME", "TMPDIR")
    return {name: value for name, value in os.environ.items() if not name.startswith(ours)} | more


@pytest.mark.slow
def test_a_home_holds_compiled_code_and_nothing_else(tmp_path: Path, sphere: Path) -> None:
    home, here, temporary = (tmp_path / name for name in ("home", "here", "temporary"))
    for folder in (home, here, temporary):
        folder.mkdir()
    store = ("--store", str(tmp_path / "store"))
    done = commands(
        (*store, "import", str(sphere)),
        (*store, "run", "register", "--session", "ball"),
        (*store, "sequence", "count", "--plot", str(tmp_path / "count.png")),
        cwd=here,
        env=plain_environment(HOME=str(home), TMPDIR=str(temporary), PYTHONPATH=str(REPOSITORY / "src")),
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert contents(here) | contents(temporary) == set()
    kept = contents(home)
    assert kept
    assert {os.path.dirname(name) for name in kept} == {".cache/lightstage"}
    assert {os.path.splitext(name)[1] for name in kept} == {".nbc", ".json"}
    assert len([name for name in kept if name.endswith(".json")]) == 1  # what is known of our own code


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that every user may enter; pytest's own are closed."""
    folder = Path(tempfile.mkdtemp(prefix="lightstage-test-"))
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


NOBODY = ("setpriv", "--reuid=65534", "--regid=65534", "--clear-groups")


def as_nobody(*words: str) -> bool:
    return (
        os.geteuid() == 0
        and shutil.which("setpriv") is not None
        and subprocess.run([*NOBODY, *words], capture_output=True, check=False).returncode == 0
    )


@pytest.mark.slow
def test_an_installation_that_cannot_be_written_runs_without_a_home(open_folder: Path) -> None:
    if not as_nobody(sys.executable, "-c", "import numpy"):
        pytest.skip("needs root, setpriv, and a Python that another user may run")
    program, store, capture = (open_folder / name for name in ("program", "store", "ball"))
    copy_package(program)
    sphere_capture(capture)
    store.mkdir()
    os.chown(store, 65534, 65534)
    calls = [
        ["--store", str(store), *words]
        for words in (("import", str(capture)), ("run", "register", "--session", "ball"))
    ]
    code = f"import sys; from lightstage.cli.main import main; sys.exit(max(main(words) for words in {calls!r}))"
    done = subprocess.run(
        [*NOBODY, sys.executable, "-B", "-c", code],
        cwd=program,
        env=plain_environment(HOME="/nonexistent"),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert contents(store / "compiled")
    assert not list(program.rglob("__pycache__"))


def test_where_nothing_can_be_written_there_is_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    store = tmp_path / "store"
    store.mkdir()
    monkeypatch.setenv("LIGHTSTAGE_COMPILED", str(store))
    assert compiled.folder() is None  # a folder that is no store stays as it is
    code = compiled.Code("f", "source")
    code.save("types", 1)
    assert code.load("types") is None
    (store / "store.json").touch()
    assert compiled.folder() == store / "compiled"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert compiled.folder() == tmp_path / "cache" / "lightstage"


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "lightstage"


def test_compiled_code_is_found_again_under_all_that_decides_it(
    kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = ("float32", ("x86_64", "skylake", "+avx512f")), ("float32", ("x86_64", "haswell", "-avx512f"))
    compiled.Code("f", "source").save(here, "here")
    compiled.Code("f", "source").save(there, "there")  # another processor's is beside it, not in its place
    assert compiled.Code("f", "source").load(here) == "here"
    assert compiled.Code("f", "source").load(there) == "there"
    assert compiled.Code("f", "edited").load(here) is None
    assert compiled.Code("f", "source").load(("f at 0x7f00", "of this process")) is None
    monkeypatch.setenv("NUMBA_OPT", "1")
    assert compiled.Code("f", "source").load(here) is None


@pytest.mark.parametrize("harm", ["flipped", "cut", "emptied", "another's"])
def test_damaged_code_and_that_of_another_user_is_not_executed(
    kept: Path, monkeypatch: pytest.MonkeyPatch, harm: str
) -> None:
    code = compiled.Code("f", "source")
    code.save("types", np.arange(100))
    (path,) = kept.iterdir()
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= harm == "flipped"
    path.write_bytes(data[: {"cut": 40, "emptied": 0}.get(harm, len(data))])
    if harm == "another's":
        monkeypatch.setattr(os, "geteuid", lambda: 12345)
    assert code.load("types") is None


def test_a_full_disk_does_not_stop_the_work(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*paths: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    compiled.Code("f", "source").save("types", 1)
    assert not list(kept.iterdir())


def test_an_edit_of_an_imported_module_compiles_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    import lightstage.kernels.motion.joint_flow  # noqa: F401  which compiles constants of block_grid into its functions

    before = compiled._source("lightstage.kernels.motion.joint_flow")
    text = compiled._text
    monkeypatch.setattr(
        compiled, "_text", lambda name: text(name) + b"#" * (name == "lightstage.kernels.motion.block_grid")
    )
    assert compiled._source("lightstage.kernels.motion.joint_flow") != before
    monkeypatch.setattr(
        compiled, "_text", lambda name: text(name) + b"#" * (name == "lightstage.kernels.appearance.gloss")
    )
    assert compiled._source("lightstage.kernels.motion.joint_flow") == before


def test_numba_asks_for_our_functions_and_not_for_others() -> None:
    from lightstage.kernels.pictures.radiance import _rounded

    assert isinstance(_rounded._cache._cache_file, compiled.Code)
    assert compiled.Place.from_function(contents, __file__) is None
