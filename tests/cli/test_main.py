"""The command as a whole: its table, help, JSON, sentences and exit codes."""

import argparse
import errno
import json
import subprocess
import sys
from pathlib import Path

import pytest

from lightstage.cli.main import COMMANDS, build_parser
from tests.cli.conftest import Lightstage, check_refusal
from tests.conftest import REPOSITORY, run_process


def names(parser: argparse.ArgumentParser) -> set[str]:
    (commands,) = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return set(commands.choices)


def test_the_table_of_commands_is_what_the_modules_have() -> None:
    assert names(build_parser()) == set(COMMANDS)
    for command, module in COMMANDS.items():
        assert names(build_parser([command])) == {name for name, home in COMMANDS.items() if home == module}


@pytest.mark.parametrize(
    ("words", "parsed"),
    [
        (["--store", "status", "run"], {"run", "normals", "performance"}),
        (["--store=x", "--json", "verify", "-h"], {"verify", "gc", "upgrade"}),
        (["--help", "run"], set(COMMANDS)),
        (["runn"], set(COMMANDS)),
        ([], set(COMMANDS)),
    ],
)
def test_only_the_module_of_the_command_is_asked(words: list[str], parsed: set[str]) -> None:
    assert names(build_parser(words)) == parsed


def test_version_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--version"], ["--help"], ["run", "--help"]):
        with pytest.raises(SystemExit) as stop:
            build_parser().parse_args(words)
        assert stop.value.code == 0
    assert "lightstage 0.1" in capsys.readouterr().out


def test_the_store_comes_from_the_environment_or_is_data(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LIGHTSTAGE_STORE", raising=False)
    assert build_parser().parse_args(["status"]).store == "data"
    monkeypatch.setenv("LIGHTSTAGE_STORE", "elsewhere")
    assert build_parser().parse_args(["status"]).store == "elsewhere"


@pytest.mark.parametrize(
    "words",
    [
        ("sessions", "list"),
        ("sessions", "show", "ball"),
        ("calibration", "list"),
        ("calibration", "show", "homography"),
        ("run", "--session", "ball"),
        ("run", "--session", "ball", "--dry-run"),
        ("status",),
        ("status", "--session", "ball"),
        ("why", "normals", "--session", "ball"),
        ("graph",),
        ("path", "normals", "--session", "ball"),
        ("path", "capture", "--session", "ball"),
        ("verify",),
        ("gc", "--dry-run"),
        ("run", "--session", "nobody"),
        ("path", "nothing", "--session", "ball"),
    ],
)
def test_json_is_one_document_and_nothing_else(
    lightstage: Lightstage, standing: Path, words: tuple[str, ...]
) -> None:
    done = lightstage(*words, "--json", store=standing)
    assert isinstance(json.loads(done.out), dict)
    assert ("error" in json.loads(done.out)) == (done.code != 0)
    plain = lightstage(*words, store=standing)
    assert plain.code == done.code
    assert plain.out.strip() or plain.code


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("runn",), "'runn' is not known; did you mean 'run'?"),
        (("run",), "--session"),
        (("run", "--session"), "expected one argument, or --session=-... where it begins with a minus"),
        (("run", "--session=--"), "'--' is no value"),
        (("--json",), "a command is missing"),
    ],
)
def test_a_wrong_request_is_one_sentence_and_exit_code_2(
    lightstage: Lightstage, words: tuple[str, ...], part: str
) -> None:
    check_refusal(lightstage(*words), part)


def test_what_the_machine_refuses_is_a_sentence_and_exit_code_1(
    lightstage: Lightstage, monkeypatch: pytest.MonkeyPatch
) -> None:
    for error, sentence in (
        (OSError(errno.EMFILE, "Too many open files", "/x/y"), "/x/y: Too many open files; raise the limit with"),
        (MemoryError("none"), "there is not enough memory for this (none)"),
        (ImportError("libx.so: failed to map segment", name="libx"), "not enough memory to load libx"),
        (KeyError("k"), "unexpected KeyError: 'k'; run again with --debug"),
    ):

        def fail(*_: object, error: Exception = error) -> None:
            raise error

        monkeypatch.setattr("lightstage.store.sessions.session_names", fail)
        done = lightstage("sessions", "list", "--json")
        assert (done.code, done.json["exit_code"]) == (1, 1)
        assert sentence in done.json["error"]
        assert done.err.endswith(f"lightstage: {done.json['error']}\n")


def test_a_store_must_be_a_folder_of_its_own(lightstage: Lightstage, sphere: Path, tmp_path: Path) -> None:
    assert "holds other files" in lightstage("import", sphere, store=sphere).err
    (tmp_path / "file").write_text("x")
    assert "is a file" in lightstage("status", store=tmp_path / "file").err
    assert "only a local folder" in lightstage("status", store="s3://bucket/x").err
    new = tmp_path / "newer"
    new.mkdir()
    (new / "store.json").write_text('{"format": "lightstage-store/9"}')
    assert "made by a newer lightstage (format 9); this program reads 2" in lightstage("status", store=new).err


@pytest.mark.slow
def test_a_full_disk_is_a_sentence_and_nothing_is_lost(tmp_path: Path, sphere: Path) -> None:
    """The disk says "no space left" when it is asked to flush for the sixth time; all else is the real code."""
    store = tmp_path / "store"
    assert run_process("import", sphere, store=store).returncode == 0
    code = (
        "import errno, os, sys\nimport lightstage.store.files\n"
        "real, left = os.fsync, [5]\n"
        "def fsync(fd):\n"
        "    left[0] -= 1\n"
        "    if left[0] < 0: raise OSError(errno.ENOSPC, 'No space left on device')\n"
        "    return real(fd)\n"
        "os.fsync = fsync\n"
        "from lightstage.cli.main import main\n"
        f"sys.exit(main(['--store', {str(store)!r}, 'run', '--session', 'ball']))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, timeout=120)
    assert done.returncode == 1
    assert "is full: nothing was lost" in done.stderr
    assert "Traceback" not in done.stderr
    assert run_process("verify", store=store).returncode == 0
    assert run_process("run", "--session", "ball", store=store).returncode == 0
    assert not list((store / "tmp").glob("*"))


def test_what_is_not_understood_names_the_command_and_the_word(lightstage: Lightstage) -> None:
    done = lightstage("status", "demo")
    assert done.code == 2
    assert "status: 'demo' is not understood (a session is named by --session, and `lightstage status" in done.err
    done = lightstage("gc", "--gracefully")
    assert "gc: '--gracefully' is not understood (`lightstage gc --help` lists what there is)" in done.err


def test_the_store_is_understood_on_either_side_of_the_command(lightstage: Lightstage, tmp_path: Path) -> None:
    done = lightstage("path", "normals", "--session", "nobody", "--store", tmp_path / "behind")
    assert done.code == 2
    assert str(tmp_path / "behind") in done.err
