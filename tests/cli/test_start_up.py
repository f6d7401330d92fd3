"""Which modules a command that computes nothing may load: what it does not load, it does not wait for."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY, run_process
from tests.scenes import sphere_capture

pytestmark = pytest.mark.slow

NUMERICS = {"numpy", "cv2", "numba", "scipy", "skimage", "colour", "pyamg", "matplotlib", "PIL", "trimesh"}
STORAGE = {"zarr", "xarray", "dask", "distributed", "numcodecs"}
READING = {"pydantic", "yaml", "lightstage.stages", "lightstage.dag.graph", "lightstage.dag.plan"}
"""A pipeline and a plan."""
LIGHT = (
    NUMERICS
    | STORAGE
    | {"rich", "lightstage.kernels.normals.methods", "lightstage.products", "lightstage.hw.virtual_rig"}
)
COMMANDS = {
    "status": (("--session", "ball"), LIGHT),
    "why": (("normals", "--session", "ball"), LIGHT),
    "graph": ((), LIGHT),
    "sessions": (("list",), LIGHT | {"lightstage.dag.graph", "lightstage.stages"}),
    "path": (("normals", "--session", "ball"), LIGHT | READING),
    "run": (("--session", "ball", "--dry-run"), LIGHT),
}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("start")
    store = folder / "store"
    assert run_process("import", sphere_capture(folder / "ball", size=16), store=store).returncode == 0
    assert run_process("run", "--session", "ball", store=store).returncode == 0
    return store


def loaded(*words: str) -> set[str]:
    """Every module that a command has loaded when it is done, and the packages that they are of."""
    code = (
        "import sys\n"
        "from lightstage.cli.main import main\n"
        "assert main(sys.argv[1:]) == 0\n"
        "print(*sys.modules, file=sys.stderr)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *words], cwd=REPOSITORY, capture_output=True, text=True, timeout=60, check=True
    )
    modules = set(done.stderr.split())
    return modules | {name.partition(".")[0] for name in modules}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_that_computes_nothing_loads_no_numerics(store: Path, command: str) -> None:
    words, forbidden = COMMANDS[command]
    assert loaded("--store", str(store), command, *words) & forbidden == set()


def test_a_command_loads_its_own_family_alone(store: Path) -> None:
    families = {
        name for name in loaded("--store", str(store), "sessions", "list") if name.startswith("lightstage.cli.")
    }
    assert families <= {
        "lightstage.cli.main",
        "lightstage.cli.show",
        "lightstage.cli.sessions",
        "lightstage.cli.values",
    }


def test_help_loads_no_numerics() -> None:
    assert loaded_by_exit("--help") & (NUMERICS | STORAGE) == set()
    assert loaded_by_exit("run", "--help") & (NUMERICS | STORAGE | READING) == set()


def loaded_by_exit(*words: str) -> set[str]:
    """The same, for what ends the process by itself."""
    code = (
        "import atexit, sys\n"
        "atexit.register(lambda: print(*sys.modules, file=sys.stderr))\n"
        "from lightstage.cli.main import main\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=60, check=True
    )
    return set(done.stderr.split())
