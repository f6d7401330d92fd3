"""verify, gc, upgrade, and a command that meets damage."""

import os
from pathlib import Path

import pytest

from tests.cli.conftest import Lightstage, check_refusal


def flip(path: Path, *, everywhere: bool) -> None:
    """Damage one byte of a file, under this name alone or under all that it has, its chunk among them."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    if not everywhere:
        path.unlink()
    path.write_bytes(data)


def chunk_of(lightstage: Lightstage, node: str, array: str) -> Path:
    group = Path(lightstage("path", node, "--session", "ball").out.strip())
    return next(path for path in sorted(group.rglob("c.*")) if path.parent.name == array)


def test_a_whole_store_is_said_to_be(lightstage: Lightstage, standing: Path) -> None:
    done = lightstage("verify", "--json", store=standing)
    assert (done.code, done.json["damaged"], done.json["strange"]) == (0, [], [])
    assert done.json["chunks"] > 20
    assert lightstage("verify", store=standing).out.endswith("all intact\n")


@pytest.mark.parametrize(
    ("everywhere", "remedy"),
    [(False, "restored from the stored chunk; nothing needs to be done"), (True, "the next run makes it again")],
)
def test_damage_is_named_once_with_its_remedy(
    lightstage: Lightstage, ball: Path, everywhere: bool, remedy: str
) -> None:
    victim = chunk_of(lightstage, "normals", "albedo")
    flip(victim, everywhere=everywhere)
    done = lightstage("verify")
    line, total = done.out.splitlines()
    assert done.code == 1
    assert line.startswith("damaged: ")
    assert line.endswith(remedy)
    assert (str(victim) in line) == (not everywhere)
    assert total.endswith(": 1 were damaged or gone")
    assert lightstage("run", "--session", "ball").code == 0
    assert lightstage("verify").code == 0


def test_a_command_that_computes_makes_anew_what_it_met_damaged(lightstage: Lightstage, ball: Path) -> None:
    flip(chunk_of(lightstage, "align", "aligned"), everywhere=True)
    done = lightstage("run", "normals", "--session", "ball", "--set", "normals.method=ratio")
    assert done.code == 0, done.err
    assert "was damaged" in done.err
    assert lightstage("verify").code == 0


@pytest.mark.parametrize("everywhere", [False, True])
def test_a_command_that_does_not_goes_on_or_says_which_one_does(
    lightstage: Lightstage, ball: Path, tmp_path: Path, everywhere: bool
) -> None:
    """A group's file is mended from its chunk; where that is damaged too, the result is set aside."""
    flip(chunk_of(lightstage, "normals", "normal"), everywhere=everywhere)
    words = ("export", "normals", "--session", "ball", "--to", tmp_path / "out", "--format", "npy")
    done = lightstage(*words)
    assert "was damaged" in done.err
    assert done.code == everywhere
    if everywhere:
        assert "`lightstage run normals --session ball` makes it again" in done.err
        assert lightstage("run", "normals", "--session", "ball").code == 0
        assert lightstage(*words).code == 0
    assert len(list((tmp_path / "out").glob("*.npy"))) == 4


def test_gc_says_beforehand_what_it_frees(lightstage: Lightstage, ball: Path) -> None:
    lightstage("sessions", "remove", "ball")
    promised = lightstage("gc", "--grace", "0s", "--dry-run", "--json").json
    freed = lightstage("gc", "--grace", "0s", "--json").json
    assert promised == {**freed, "dry_run": True}
    assert freed["chunks"] > 20
    assert freed["items"] == 2
    assert "freed 0" in lightstage("gc", "--grace", "0s").out


def test_a_grace_keeps_what_is_young(lightstage: Lightstage, ball: Path, tmp_path: Path) -> None:
    lightstage("sessions", "remove", "ball")
    for grace in ("7d", "12h", "30m", "90s", "90"):
        assert lightstage("gc", "--grace", grace, "--dry-run", "--json").json["chunks"] == 0
    aged = [path for path in (tmp_path / "store").rglob("*") if path.is_file()]
    for path in aged:
        os.utime(path, (path.stat().st_atime, path.stat().st_mtime - 3600))
    assert lightstage("gc", "--grace", "30m", "--dry-run", "--json").json["chunks"] > 20
    assert lightstage("gc", "--grace", "2h", "--dry-run", "--json").json["chunks"] == 0


def test_a_store_of_this_format_needs_no_upgrade(lightstage: Lightstage, standing: Path) -> None:
    done = lightstage("upgrade", "--json", store=standing).json
    assert done["from"] == done["to"]
    assert (done["carried"], done["left"]) == ({}, [])
    assert "nothing to do" in lightstage("upgrade", store=standing).out


@pytest.mark.parametrize("grace", ["soon", "-1s", "1w", "1.5h", ""])
def test_a_grace_that_is_no_time_is_refused(lightstage: Lightstage, standing: Path, grace: str) -> None:
    check_refusal(lightstage("gc", f"--grace={grace}", store=standing), "expected a time")
