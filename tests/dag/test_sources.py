"""Which files are ours, and what of them a process executes: not what stands on the disk by now."""

import importlib
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from lightstage.dag import code, sources
from lightstage.dag.sources import ROOT, outdated, read_sources
from lightstage.store.digest import digest_bytes
from tests.package import copy_package

Package = Callable[..., Path]


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Package]:
    """A package that counts as ours, with a module of this text; returns the module's file."""
    made: list[str] = []

    def make(name: str, text: str) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        (folder / "__init__.py").write_text("")
        (folder / "part.py").write_text(text)
        monkeypatch.setattr(sources, "PACKAGE", name)
        monkeypatch.syspath_prepend(str(tmp_path))
        made.append(name)
        return folder / "part.py"

    yield make
    for name in [n for n in [*sys.modules, *sources._executed] if n.partition(".")[0] in made]:
        sys.modules.pop(name, None)
        sources._executed.pop(name, None)


def edit(path: Path, text: str) -> None:
    """As `rsync -t` does it: the new text has the size and the times of the old one."""
    before = path.stat()
    path.write_text(text)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_size == before.st_size


def test_a_key_is_made_of_what_was_executed(package: Package) -> None:
    """A worker that lives on while a module is edited computes the old text's numbers, under the old text's key."""
    path = package("oursone", "LIMIT = 3\n")
    module = importlib.import_module("oursone.part")
    old = code.module_code(["oursone.part"])
    edit(path, "LIMIT = 4\n")
    code._module_code.cache_clear()
    assert code.module_code(["oursone.part"]) == old
    assert module.LIMIT == 3
    importlib.reload(module)
    assert code.module_code(["oursone.part"]) != old


def test_an_edit_that_leaves_size_and_time_is_executed(package: Package) -> None:
    """Python alone would execute what it had compiled before."""
    path = package("ourstwo", "LIMIT = 3\n")
    assert importlib.import_module("ourstwo.part").LIMIT == 3
    edit(path, "LIMIT = 4\n")
    del sys.modules["ourstwo.part"]
    assert importlib.import_module("ourstwo.part").LIMIT == 4
    assert sources.source("ourstwo.part") == b"LIMIT = 4\n"


def test_what_is_in_memory_and_not_on_the_disk_is_told(package: Package) -> None:
    path = package("oursthree", "LIMIT = 3\n")
    importlib.import_module("oursthree.part")
    before = read_sources(path.parent)
    assert outdated(before) == []
    edit(path, "LIMIT = 4\n")
    now = read_sources(path.parent)
    assert outdated(now) == ["oursthree.part"]
    edit(path, "LIMIT = 3\n")
    # the text is the old one, and yet it was another in between
    assert read_sources(path.parent).digest == before.digest
    assert read_sources(path.parent) != before


def test_an_edit_of_any_file_in_any_folder_counts(package: Package, tmp_path: Path) -> None:
    """Walked, so that no folder and no kind of file has to be remembered; also files that come and go."""
    tmp_path = copy_package(tmp_path)
    folders = sorted({path.parent for path in tmp_path.rglob("*") if path.is_file()})
    assert {tmp_path / "cli", tmp_path / "stages" / "calibration", tmp_path / "kernels" / "normals"} < set(folders)
    whole = read_sources(tmp_path).digest
    for folder in folders:
        kinds = {path.suffix: path for path in sorted(folder.iterdir()) if path.is_file()}
        for path in kinds.values():
            text = path.read_bytes()
            path.write_bytes(text + b"\n")
            assert read_sources(tmp_path).digest != whole, path
            path.write_bytes(text)
        new = folder / "table.csv"
        new.write_text("1,2\n")
        assert read_sources(tmp_path).digest != whole, new
        new.unlink()
    assert read_sources(tmp_path).digest == whole


def test_links_to_folders_are_followed_and_circles_end(tmp_path: Path) -> None:
    (tmp_path / "ours").mkdir()
    (tmp_path / "ours" / "__init__.py").write_text("")
    (tmp_path / "ours" / "again").symlink_to(tmp_path / "ours")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "data.txt").write_text("x")
    (tmp_path / "ours" / "linked").symlink_to(tmp_path / "elsewhere")
    assert list(read_sources(tmp_path / "ours").digests) == ["__init__.py", "linked/data.txt"]


def test_the_engine_is_of_dag_and_store(package: Package, monkeypatch: pytest.MonkeyPatch) -> None:
    before = sources.engine()
    for module, text in (("lightstage.dag.task", b"# another"), ("lightstage.store.chunks", b"# another")):
        with monkeypatch.context() as patch:
            patch.setitem(sources._executed, module, text)
            assert sources._engine.__wrapped__(0) != before
    assert sources._engine.__wrapped__(0) == before


def test_a_library_that_nobody_has_spoken_of_is_refused(package: Package) -> None:
    package("oursfour", "import tifffile\n")
    with pytest.raises(ModuleNotFoundError, match="imports tifffile, which is neither in NUMERIC nor in SILENT"):
        code.module_libraries(["oursfour.part"])


def test_the_record_is_of_our_modules_as_their_files_stand() -> None:
    for module in ("lightstage.dag.plan", "lightstage.store.records", "lightstage.cli.main"):
        importlib.import_module(module)
        text = (ROOT / f"{module.removeprefix('lightstage.').replace('.', '/')}.py").read_bytes()
        assert digest_bytes(sources._executed[module]) == digest_bytes(text)
