"""What is installed: one package, whole, that runs from any folder and beside anybody's modules."""

import os
import shutil
import stat
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path
from zipfile import ZipFile

import pytest

from lightstage.cli.main import COMMANDS
from lightstage.dag.sources import PACKAGE, ROOT
from tests.conftest import REPOSITORY

pytestmark = pytest.mark.slow

FOLDERS = ("api", "cli", "dag", "formats", "hw", "kernels", "products", "stages", "store")


def checked(*words: str | Path, **options: object) -> str:
    """What a command prints that must succeed."""
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True, timeout=300, **options)  # type: ignore[call-overload]
    assert done.returncode == 0, done.stderr
    return str(done.stdout)


def build_wheel(source: Path, folder: Path) -> Path:
    """The wheel of a source tree or archive, by the tool that is there, without an index."""
    if shutil.which("uv"):
        checked("uv", "build", "--wheel", "--no-build-isolation", "--python", sys.executable, "-o", folder, source)
    else:
        checked(sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-w", folder, source)
    (wheel,) = folder.glob("*.whl")
    return wheel


def contents(wheel: Path) -> dict[str, bytes]:
    with ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_wheel(REPOSITORY, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def programs(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The programs of a new environment: the wheel is installed, the libraries are those of this one."""
    home = tmp_path_factory.mktemp("environment")
    venv.create(home)
    programs = home / "bin"
    if shutil.which("uv"):
        checked("uv", "pip", "install", "--no-deps", "--python", programs / "python", wheel)
    else:
        checked(sys.executable, "-m", "pip", "--python", programs / "python", "install", "--no-deps", wheel)
    (libraries,) = home.glob("lib/python*/site-packages")
    # a path file in a folder that a path file adds is not read: the copy under test is not seen
    (libraries / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return programs


def plain_environment(**more: str) -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | more


def test_a_wheel_is_one_package_with_all_its_files(wheel: Path) -> None:
    files = contents(wheel)
    assert {name.split("/")[0] for name in files} == {PACKAGE, "-".join(wheel.name.split("-")[:2]) + ".dist-info"}
    ours = {name: data for name, data in files.items() if name.startswith(f"{PACKAGE}/")}
    expected = {
        f"{PACKAGE}/{path.relative_to(ROOT).as_posix()}": path.read_bytes()
        for folder in (ROOT, *(ROOT / name for name in FOLDERS))
        for path in (folder.glob("*") if folder == ROOT else folder.rglob("*"))
        if path.is_file() and path.suffix in (".py", ".yaml")
    }
    assert ours == expected
    assert {f"{PACKAGE}/pipeline.yaml", f"{PACKAGE}/calibration.yaml"} <= set(ours)
    assert {f"{PACKAGE}/{folder}/__init__.py" for folder in FOLDERS} <= set(ours)
    with ZipFile(wheel) as archive:
        assert not any(stat.S_ISLNK(entry.external_attr >> 16) for entry in archive.infolist())


def test_a_source_archive_makes_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    checked(sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", tmp_path, cwd=REPOSITORY)
    (archive,) = tmp_path.glob("*.tar.gz")
    assert contents(build_wheel(archive, tmp_path)) == contents(wheel)


def test_the_installed_command_runs_from_another_folder(programs: Path, tmp_path: Path) -> None:
    options: dict[str, object] = {"cwd": tmp_path, "env": plain_environment()}
    place = checked(programs / "python", "-c", "import lightstage; print(lightstage.__file__)", **options)
    assert Path(place).is_relative_to(programs.parent)
    command = (programs / "lightstage", "--store", tmp_path / "store")
    assert "normals" in checked(*command, "graph", **options)
    checked(*command, "demo", "--size", "48x36", "--bands", "576", **options)
    checked(*command, "run", "--session", "demo", **options)
    assert Path(checked(*command, "path", "normals", "--session", "demo", **options).strip()).is_dir()
    assert {path.name for path in tmp_path.iterdir()} == {"store"}


def test_modules_of_somebody_else_with_our_folders_names_are_not_ours(programs: Path, tmp_path: Path) -> None:
    for folder in FOLDERS:
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "__init__.py").write_text("raise SystemExit('a stranger is imported')\n")
    options: dict[str, object] = {"cwd": tmp_path, "env": plain_environment(PYTHONPATH=str(tmp_path))}
    assert "normals" in checked(programs / "lightstage", "graph", **options)
    code = f"from lightstage.cli.main import main\nassert not any(main([name, '--help']) for name in {[*COMMANDS]})"
    checked(programs / "python", "-c", code, **options)
    checked(sys.executable, "-c", code, **options)  # as installed for development
    command = (programs / "lightstage", "--store", tmp_path / "data")
    checked(*command, "demo", "--size", "48x36", "--bands", "576", **options)
    checked(*command, "run", "normals", "--session", "demo", **options)
