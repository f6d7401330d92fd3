"""A second run, a changed parameter, item or picture, a kill, a second process: they cost only what they must."""

import contextlib
import filecmp
import random
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import xarray

from lightstage.dag import task as dag_task
from lightstage.kernels.errors import KernelError
from lightstage.kernels.pictures import registration
from lightstage.store.importer import import_capture
from lightstage.store.root import Store
from lightstage.store.sessions import read_session
from tests.conftest import REPOSITORY, Answer, run_process
from tests.scenes import one_camera_capture, sphere_capture

Lightstage = Callable[..., Answer]


def counts(answer: Answer) -> dict[str, tuple[int, int]]:
    assert answer.code == 0, answer.err
    return {name: (node["computed"], node["reused"]) for name, node in answer.json["nodes"].items()}


def computed(answer: Answer) -> dict[str, int]:
    return {name: done for name, (done, _) in counts(answer).items() if done}


@pytest.fixture
def ball(lightstage: Lightstage, sphere: Path) -> Path:
    """The sphere, imported and run."""
    assert lightstage("import", sphere).code == 0
    assert computed(lightstage("run", "--session", "ball", "--json")) == {
        "register": 7,
        "split": 7,
        "stack": 7,
        "align": 1,
        "normals": 1,
        "upsample": 1,
    }
    return sphere


def run(lightstage: Lightstage, *words: str) -> dict[str, int]:
    return computed(lightstage("run", "--session", "ball", "--json", *words))


def change_picture(folder: Path, name: str, by: int = 1) -> None:
    picture = cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)
    picture[20:28, 20:28] += by
    cv2.imwrite(str(folder / name), picture)


def test_a_second_run_computes_nothing(lightstage: Lightstage, ball: Path) -> None:
    assert run(lightstage) == {}


def test_a_changed_parameter_costs_its_node_and_setting_it_back_costs_nothing(
    lightstage: Lightstage, ball: Path
) -> None:
    first = lightstage("path", "normals", "--session", "ball").out
    assert run(lightstage, "--set", "normals.method=ratio") == {"normals": 1, "upsample": 1}
    assert lightstage("path", "normals", "--session", "ball").out != first
    assert run(lightstage) == {}
    assert lightstage("path", "normals", "--session", "ball").out == first
    assert run(lightstage, "--set", "normals.method=auto") == {}


def test_one_changed_picture_costs_its_dependants(lightstage: Lightstage, ball: Path) -> None:
    change_picture(ball, "0004_Xc_576nm_CAM1.png")
    lightstage("import", ball)
    assert run(lightstage) == {"register": 1, "split": 1, "stack": 1, "align": 1, "normals": 1, "upsample": 1}


def test_equal_output_stops_the_cascade_in_the_same_run(lightstage: Lightstage, ball: Path) -> None:
    """Normals of the diffuse component do not read the parallel camera's picture."""
    change_picture(ball, "0004_Xc_576nm_CAM0.png")
    lightstage("import", ball)
    assert run(lightstage) == {"register": 1, "split": 1, "stack": 1, "align": 1}


def test_a_first_stage_that_ran_again_with_identical_output_computes_nothing_below(
    lightstage: Lightstage, ball: Path
) -> None:
    """There is no flat, so its smoothing is in register's key and not in its numbers."""
    assert run(lightstage, "--set", "register.flat_smoothing_percent=3") == {"register": 7}


def test_a_changed_homography_runs_register_again_and_an_equal_one_does_not(
    lightstage: Lightstage, ball: Path, tmp_path: Path
) -> None:
    item = tmp_path / "h.yaml"
    item.write_text(
        "item: homography\nfrom: CAM0\nto: CAM1\nmatrix: [[1.0,0.0,-1.0],[0,1.0,0],[0,0,1e0]]\nrig: york\n"
    )
    assert run(lightstage, "--calibration", f"homography={item}") == {}
    # the same map, scaled and the other way round
    item.write_text("item: homography\nfrom: CAM1\nto: CAM0\nmatrix: [[2, 0, 2], [0, 2, 0], [0, 0, 2]]\n")
    assert run(lightstage, "--calibration", f"homography={item}") == {}
    item.write_text("item: homography\nfrom: CAM0\nto: CAM1\nmatrix: [[1, 0, -1.5], [0, 1, 0], [0, 0, 1]]\n")
    # all of register; the diffuse chunks come out equal, but each split block also reads the other camera
    assert run(lightstage, "--calibration", f"homography={item}") == {
        "register": 7,
        "split": 7,
        "stack": 7,
        "align": 1,
    }
    assert run(lightstage) == {}


def test_a_preview_is_reused_by_the_full_run(lightstage: Lightstage, sphere: Path) -> None:
    lightstage("import", sphere)
    preview = lightstage("run", "--session", "ball", "--json", "--frames", "0:3")
    assert computed(preview) == {"register": 3, "split": 3, "stack": 3}
    assert preview.json["nodes"]["normals"]["path"] is None
    assert "each of its blocks needs frames outside 0:3" in preview.err
    partial = xarray.open_zarr(preview.json["nodes"]["register"]["path"], chunks=None)
    assert np.isfinite(partial.signal.values[:3]).any(axis=(1, 2, 3, 4)).all()
    assert np.isnan(partial.signal.values[3:]).all()
    status = lightstage("status", "--session", "ball", "--json").json["sessions"]["ball"]
    assert {name: node["status"] for name, node in status.items()} == {
        "register": "partial",
        "split": "partial",
        "stack": "partial",
        "align": "missing",
        "normals": "missing",
        "upsample": "missing",
    }
    assert counts(lightstage("run", "--session", "ball", "--json"))["register"] == (4, 3)


def test_status_and_why_tell_the_truth(lightstage: Lightstage, ball: Path) -> None:
    def status(*words: str) -> dict[str, str]:
        nodes = lightstage("status", "--session", "ball", "--json", *words).json["sessions"]["ball"]
        return {name: node["status"] for name, node in nodes.items()}

    assert set(status().values()) == {"fresh"}
    assert status("--set", "normals.method=minimal")["normals"] == "stale"
    why = lightstage("why", "normals", "--session", "ball", "--json", "--set", "normals.method=minimal").json
    reasons = {r["what"].split(" (")[0]: (r["old"], r["new"]) for r in why["reasons"]}
    assert reasons["parameters.method"] == ("auto", "minimal")
    change_picture(ball, "0004_Xc_576nm_CAM1.png")
    lightstage("import", ball)
    assert set(status().values()) == {"stale"}
    why = lightstage("why", "normals", "--session", "ball", "--json").json
    assert {(r["node"], r["what"]) for r in why["reasons"]} == {("register", "input of frame 4 (Xc), 576 nm")}
    run(lightstage)
    why = lightstage("why", "normals", "--session", "ball", "--json").json
    assert "is fresh" in why["summary"]
    assert ("register", "input of frame 4 (Xc), 576 nm") in {(r["node"], r["what"]) for r in why["reasons"]}


def test_a_dry_run_says_what_a_run_does_and_writes_nothing(
    lightstage: Lightstage, ball: Path, tmp_path: Path
) -> None:
    before = sorted(p for p in (tmp_path / "store").rglob("*"))
    dry = lightstage("run", "--session", "ball", "--json", "--dry-run", "--set", "split.x=1")
    assert dry.code == 2
    dry = lightstage("run", "--session", "ball", "--json", "--dry-run", "--set", "normals.method=ratio").json[
        "nodes"
    ]
    assert dry["normals"] == {"compute": 1, "check": 0, "reuse": 0}
    assert dry["stack"] == {"compute": 0, "check": 0, "reuse": 7}
    assert sorted(p for p in (tmp_path / "store").rglob("*")) == before


def test_results_are_plain_zarr_with_their_provenance(lightstage: Lightstage, ball: Path) -> None:
    path = lightstage("path", "normals", "--session", "ball").out.strip()
    opened = xarray.open_zarr(path, chunks=None)
    assert opened.normal.dims == ("tracking", "band", "xyz", "y", "x")
    assert opened.albedo.dims == ("tracking", "band", "y", "x")
    assert opened.attrs["method"] == "difference"
    stack = xarray.open_zarr(lightstage("path", "stack", "--session", "ball").out.strip(), chunks=None)
    assert stack.radiance.dims == ("illumination", "band", "component", "y", "x")
    assert set(stack.attrs["calibration_items"]) == {"bands"}
    register = xarray.open_zarr(lightstage("path", "register", "--session", "ball").out.strip(), chunks=None)
    assert register.signal.dims == ("frame", "band", "polarisation", "y", "x")
    assert register.valid.dims == ("frame", "band", "y", "x")
    assert "vignetting" in register.attrs["calibration_absent"]
    split = xarray.open_zarr(lightstage("path", "split", "--session", "ball").out.strip(), chunks=None)
    assert list(split.component.values) == ["diffuse", "specular"]
    assert 0 <= split.attrs["negative_specular_fraction"] < 1


def same_trees(a: Path, b: Path) -> bool:
    compared = filecmp.dircmp(a, b)
    if compared.left_only or compared.right_only or compared.funny_files:
        return False
    _, different, errors = filecmp.cmpfiles(a, b, compared.common_files, shallow=False)
    return not different and not errors and all(same_trees(a / name, b / name) for name in compared.common_dirs)


def groups(store: Path) -> dict[str, Path]:
    return {
        node: next((store / "results" / "s" / node).glob("*-*/"))
        for node in ("register", "split", "stack", "normals")
    }


@pytest.mark.slow
def test_killed_at_random_moments_and_run_again_it_is_as_if_undisturbed(tmp_path: Path) -> None:
    folder = sphere_capture(tmp_path / "s", size=200, bands=(434, 576, 655))
    imported = tmp_path / "imported"
    opened = Store(imported)
    import_capture(folder, opened)
    opened.scratch.leave()
    undisturbed = shutil.copytree(imported, tmp_path / "undisturbed", symlinks=True)
    assert run_process("run", "--session", "s", store=undisturbed).returncode == 0
    total = 3 * 21 + 1 + 3 + 1
    generator = random.Random(5)
    for i in range(10):
        store = shutil.copytree(imported, tmp_path / f"killed{i}", symlinks=True)
        blocks = store / "cache" / "blocks"
        command = [sys.executable, "-m", "lightstage.cli.main", "--store", str(store), "run", "--session", "s"]
        process = subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        wanted, deadline = generator.randrange(total), time.monotonic() + 60
        while len(list(blocks.rglob("*.json"))) < wanted and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.001)
        time.sleep(generator.uniform(0, 0.02))
        process.send_signal(signal.SIGKILL)
        process.wait()
        known = len(list(blocks.rglob("*.json")))
        again = run_process("run", "--session", "s", "--json", store=store)
        assert again.returncode == 0, again.stderr
        # nothing that was recorded is computed again: only what was in flight is lost
        done = sum(node["computed"] for node in Answer(0, again.stdout, "").json["nodes"].values())
        assert known + done == total
        for node, path in groups(store).items():
            assert same_trees(path, groups(undisturbed)[node]), node
        assert not list((store / "tmp").glob("*"))
        assert not list(store.rglob("*.part*"))
        assert run_process("verify", store=store).returncode == 0


@pytest.mark.slow
def test_two_runs_at_once_agree(tmp_path: Path) -> None:
    folder = sphere_capture(tmp_path / "s", size=120, bands=(434, 576))
    alone, shared = Store(tmp_path / "a"), Store(tmp_path / "b")
    import_capture(folder, alone)
    import_capture(folder, shared)
    assert run_process("run", "--session", "s", store=alone.root).returncode == 0
    command = [sys.executable, "-m", "lightstage.cli.main", "--store", str(shared.root), "run", "--session", "s"]
    processes = [subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.DEVNULL) for _ in range(2)]
    assert [process.wait(120) for process in processes] == [0, 0]
    for node, path in groups(shared.root).items():
        assert len(list(path.parent.glob("*-*/"))) == 1
        assert same_trees(path, groups(alone.root)[node]), node


@pytest.mark.slow
def test_processes_give_the_same_bits_as_threads(tmp_path: Path) -> None:
    folder = sphere_capture(tmp_path / "s", bands=(434, 576))
    threads, workers = Store(tmp_path / "a"), Store(tmp_path / "b")
    import_capture(folder, threads)
    import_capture(folder, workers)
    assert run_process("run", "--session", "s", store=threads.root).returncode == 0
    here = tmp_path / "here"
    here.mkdir()
    workers.scratch.leave()
    with contextlib.ExitStack() as taken:
        with contextlib.suppress(OSError):  # Dask's port: whoever wants it would say that it is taken
            taken.enter_context(socket.create_server(("", 8787)))
        done = run_process("run", "--session", "s", "--workers", "2", "--json", store=workers.root, cwd=here)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert not list(here.iterdir())
    assert not list((workers.root / "tmp").iterdir())
    assert Answer(0, done.stdout, "").json["nodes"]["register"]["computed"] == 14
    for node, path in groups(workers.root).items():
        assert same_trees(path, groups(threads.root)[node]), node


@pytest.mark.slow
def test_a_cached_run_imports_no_stage_no_dask_and_no_zarr(tmp_path: Path, sphere: Path) -> None:
    store = tmp_path / "store"
    run_process("import", sphere, store=store)
    assert run_process("run", "--session", "ball", store=store).returncode == 0
    code = (
        "import sys\nfrom lightstage.cli.main import main\n"
        f"assert main(['--store', {str(store)!r}, 'run', '--session', 'ball', '--json']) == 0\n"
        "heavy = {'dask', 'zarr', 'numpy', 'numba', 'cv2', 'xarray', 'pydantic', 'yaml', 'rich'}\n"
        "found = heavy & {name.split('.')[0] for name in sys.modules}\n"
        "found |= {name for name in sys.modules if name.startswith(('lightstage.stages', 'lightstage.kernels'))}\n"
        "assert not found, found\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_a_damaged_result_is_found_quarantined_and_made_again(
    lightstage: Lightstage, ball: Path, tmp_path: Path
) -> None:
    store = tmp_path / "store"
    folder = Path(lightstage("path", "stack", "--session", "ball").out.strip())
    victim = folder / "radiance" / "c.2.0.0.0.0"
    good = victim.read_bytes()
    data = bytearray(good)
    data[len(data) // 2] ^= 4
    with open(victim, "r+b") as file:  # in place, as a failing disk does: the blob is the same file
        file.write(data)
    verified = lightstage("verify", "--json")
    assert verified.code == 1
    (damage,) = verified.json["damaged"]
    assert "ball/stack, array radiance, chunk 2/0/0/0/0" in damage["belongs_to"]
    assert len(list((store / "quarantine").iterdir())) == 1
    # the unmoved picture is the same blob
    assert run(lightstage) == {"stack": 1, "align": 1}
    assert victim.read_bytes() == good
    assert lightstage("verify").code == 0


def test_a_file_that_replaced_a_link_is_found_too(lightstage: Lightstage, ball: Path) -> None:
    folder = Path(lightstage("path", "stack", "--session", "ball").out.strip())
    victim = folder / "radiance" / "c.2.0.0.0.0"
    data = bytearray(victim.read_bytes())
    data[-1] ^= 1
    victim.unlink()
    victim.write_bytes(data)
    assert lightstage("verify").code == 1
    assert run(lightstage) == {}
    assert folder.is_dir()
    assert lightstage("verify").code == 0


def test_damage_met_on_the_way_is_healed_in_the_same_run(
    lightstage: Lightstage, ball: Path, tmp_path: Path
) -> None:
    folder = Path(lightstage("path", "stack", "--session", "ball").out.strip())
    victim = folder / "radiance" / "c.1.0.0.0.0"
    data = bytearray(victim.read_bytes())
    data[-1] ^= 1
    with open(victim, "r+b") as file:
        file.write(data)
    done = lightstage("run", "--session", "ball", "--json", "--set", "normals.method=ratio")
    assert computed(done) == {"stack": 1, "align": 1, "normals": 1, "upsample": 1}
    assert "was damaged: ball/stack" in done.err


def test_a_damaged_raw_picture_names_the_folder_to_import(
    lightstage: Lightstage, ball: Path, tmp_path: Path
) -> None:
    store = Store(tmp_path / "store")
    ref = read_session("ball", store).images[3][0][1]
    path = store.chunks.path(ref.blob)
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)
    verified = lightstage("verify")
    assert verified.code == 1
    assert f"import {ball} again" in verified.out
    assert "frame 3 (Z)" in verified.out
    assert lightstage("import", ball).code == 0
    assert lightstage("verify").code == 0
    assert run(lightstage) == {}


def test_gc_frees_what_nothing_uses_and_nothing_else(lightstage: Lightstage, ball: Path) -> None:
    run(lightstage, "--set", "normals.method=ratio")
    run(lightstage)
    assert lightstage("gc", "--json").json["bytes"] == 0  # all of it is younger than the grace period
    dry = lightstage("gc", "--grace", "0s", "--dry-run", "--json").json
    assert dry["results"] == 2
    assert dry["bytes"] > 0
    freed = lightstage("gc", "--grace", "0s", "--json").json
    assert freed["bytes"] == dry["bytes"]
    assert lightstage("verify").code == 0
    assert run(lightstage) == {}
    assert run(lightstage, "--set", "normals.method=ratio") == {"normals": 1, "upsample": 1}


def test_a_kernels_refusal_names_node_and_block(
    lightstage: Lightstage, ball: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(raw: Any, *, views: Any, grid: Any, white_level: Any) -> Any:
        raise KernelError("the two cameras disagree")

    monkeypatch.setattr(registration, "register", refuse)
    change_picture(ball, "0004_Xc_576nm_CAM1.png")
    lightstage("import", ball)
    done = lightstage("run", "--session", "ball")
    assert done.code == 1
    assert "register, frame 4 (Xc), 576 nm: the two cameras disagree" in done.err


def test_a_performance_gives_normals_at_every_tracking_frame_with_a_full_set(
    lightstage: Lightstage, tmp_path: Path
) -> None:
    sequence = ["X", "Z", "C", "Y", "Xc", "C", "Zc", "Yc", "C", "X", "Z", "C"]
    folder = one_camera_capture(tmp_path / "p", sequence, frame_rate_hz=60.0)
    lightstage("import", folder)
    done = lightstage("run", "--session", "p", "--json")
    assert done.code == 0, done.err
    opened = xarray.open_zarr(done.json["nodes"]["normals"]["path"], chunks=None)
    # windows: X Z [C] Y Xc; Y Xc [C] Zc Yc; Zc Yc [C] X Z; X Z [C] has no full set
    assert opened.tracking.values.tolist() == [2, 5, 8]
    assert opened.attrs["method"] == "minimal"
    assert opened.attrs["base"] == "X, Y, Z"
    part = lightstage("run", "--session", "p", "--json", "--frames", "0:6").json["nodes"]["normals"]
    assert (part["computed"], part["reused"]) == (0, 1)


def test_memory_of_a_store_moves_with_it(lightstage: Lightstage, ball: Path, tmp_path: Path) -> None:
    """Nothing in the store names its own place."""
    moved = tmp_path / "moved"
    shutil.move(tmp_path / "store", moved)
    done = lightstage("run", "--session", "ball", "--json", store=moved)
    assert computed(done) == {}
    assert lightstage("verify", store=moved).code == 0


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    with open(path, "r+b") as file:
        file.write(data)


def result(lightstage: Lightstage, node: str) -> Path:
    return Path(lightstage("path", node, "--session", "ball").out.strip())


def test_labels_that_change_alone_reach_the_results_and_cost_nothing(lightstage: Lightstage, ball: Path) -> None:
    """A wrong time in capture.yaml is put right: no pixel changes, and the results must not keep the old one."""
    text = (ball / "capture.yaml").read_text()
    (ball / "capture.yaml").write_text(text.replace("- illumination: X\n", "- illumination: X\n  time_s: 0.25\n"))
    assert "time_s changed" in lightstage("import", ball).out
    assert run(lightstage) == {}
    opened = xarray.open_zarr(result(lightstage, "register"), chunks=None)
    assert opened.time_s.values[1] == 0.25


def test_files_that_somebody_deleted_are_noticed_and_linked_again(lightstage: Lightstage, ball: Path) -> None:
    group = result(lightstage, "normals")
    chunk, metadata = group / "albedo" / "c.0.0.0.0", group / "albedo" / "zarr.json"
    chunk.unlink()
    assert (
        lightstage("status", "--session", "ball", "--json").json["sessions"]["ball"]["normals"]["status"]
        == "partial"
    )
    verified = lightstage("verify")
    assert verified.code == 1
    assert "restored from the stored chunk" in verified.out
    assert chunk.is_file()
    chunk.unlink()
    assert run(lightstage) == {}
    assert chunk.is_file()
    metadata.unlink()
    assert lightstage("verify").code == 1
    assert run(lightstage) == {}
    assert metadata.is_file()
    assert lightstage("verify").code == 0


def test_a_flipped_byte_in_a_coordinate_is_found(lightstage: Lightstage, ball: Path) -> None:
    flip(result(lightstage, "stack") / "frame" / "c.0")
    assert lightstage("verify").code == 1
    assert run(lightstage) == {}
    assert lightstage("verify").code == 0


def test_many_damaged_chunks_are_healed_at_once(lightstage: Lightstage, ball: Path) -> None:
    group = result(lightstage, "stack")
    # not C, whose diffuse picture is the albedo too, and so the same stored chunk
    for illumination in range(1, 7):
        flip(group / "radiance" / f"c.{illumination}.0.0.0.0")
    flip(result(lightstage, "register") / "signal" / "c.0.0.1.0.0")
    again = run(lightstage, "--set", "normals.method=minimal")
    assert again["stack"] == 6
    assert again["register"] == 1
    flip(result(lightstage, "stack") / "radiance" / "c.3.0.0.0.0")
    assert lightstage("verify").code == 1
    flip(result(lightstage, "register") / "signal" / "c.1.0.1.0.0")
    assert lightstage("verify").code == 1
    assert run(lightstage) == {"register": 1, "stack": 1, "align": 1}


def test_a_lost_cache_does_not_cost_the_raw_pictures(lightstage: Lightstage, ball: Path, tmp_path: Path) -> None:
    """The group that shows the pictures still holds them: verify takes them back from there."""
    shutil.rmtree(tmp_path / "store" / "cache")
    verified = lightstage("verify", "--json")
    assert verified.code == 1
    raw = read_session("ball", Store(tmp_path / "store"))
    assert all(Store(tmp_path / "store").chunks.intact(ref) for ref in raw.refs())
    assert sum(run(lightstage).values()) == 24
    assert lightstage("verify").code == 0


def test_a_preview_does_not_let_gc_free_the_full_result(lightstage: Lightstage, ball: Path) -> None:
    run(lightstage, "--frames", "0:2")
    lightstage("gc", "--grace", "0s")
    assert run(lightstage) == {}


def test_an_item_bound_by_hand_outlives_an_unchanged_import(
    lightstage: Lightstage, ball: Path, tmp_path: Path
) -> None:
    item = tmp_path / "better.yaml"
    item.write_text("item: homography\nfrom: CAM0\nto: CAM1\nmatrix: [[1, 0, -1.25], [0, 1, 0], [0, 0, 1]]\n")
    lightstage("calibration", "use", item, "--session", "ball")
    assert "nothing has changed" in lightstage("import", ball).out
    assert run(lightstage)["register"] == 7
    own = ball / "calibration" / "homography.yaml"
    own.write_text(item.read_text().replace("-1.25", "-1.5"))
    assert "calibration item homography changed" in lightstage("import", ball).out
    own.unlink()
    assert "calibration item homography is gone" in lightstage("import", ball).out
    assert "no homography item" in lightstage("run", "--session", "ball").err


def test_an_items_notes_can_stop_a_cached_run(lightstage: Lightstage, tmp_path: Path) -> None:
    folder = one_camera_capture(tmp_path / "c", ["C", "X", "Y", "Z"], rig="york")
    lightstage("import", folder)
    item = tmp_path / "bands.yaml"
    for rig, code in (("york", 0), ("leeds", 2)):
        item.write_text(f"item: bands\nrig: {rig}\nbands: [{{centre_nm: 0, exposure: 2}}]\n")
        lightstage("calibration", "use", item, "--session", "c")
        assert lightstage("run", "--session", "c").code == code


def test_broken_small_files_are_named_and_can_be_mended(lightstage: Lightstage, ball: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    note = next((store / "results" / "ball" / "stack").glob("*-*.json"))
    note.write_text("{")
    assert lightstage("verify").code == 1
    assert run(lightstage) == {}
    session = store / "sessions" / "ball" / "session.json"
    session.write_text(session.read_text()[:100])
    for words in (("status",), ("run", "--session", "ball"), ("sessions", "list"), ("gc",)):
        assert f"{session} is damaged; import the capture folder" in lightstage(*words).err
    assert lightstage("verify").code == 1
    assert lightstage("import", ball).code == 0
    assert run(lightstage) == {}
    session.write_text("{")
    assert lightstage("sessions", "remove", "ball").code == 0


def test_a_nodes_name_cannot_lead_out_of_the_store(lightstage: Lightstage, ball: Path, tmp_path: Path) -> None:
    text = (REPOSITORY / "pipeline.yaml").read_text()
    for name in ("../../evil", "a/b", "..", "current"):
        path = tmp_path / "p.yaml"
        path.write_text(text + f'  "{name}": {{uses: normals, from: align}}\n')
        done = lightstage("run", "--session", "ball", "--pipeline", path)
        assert done.code == 2
        assert "cannot name a node" in done.err


def test_no_light_is_no_normal(lightstage: Lightstage, tmp_path: Path) -> None:
    folder = one_camera_capture(tmp_path / "dark", ["C", "X", "Y", "Z"])
    cv2.imwrite(str(folder / "0000_C_0nm_CAM1.png"), np.zeros((12, 16), np.uint16))
    lightstage("import", folder)
    done = lightstage("run", "--session", "dark", "--json")
    opened = xarray.open_zarr(done.json["nodes"]["normals"]["path"], chunks=None)
    assert not opened.valid.values.any()
    for name in ("normal", "albedo", "norm"):
        assert np.isnan(opened[name].values).all(), name


def test_a_worker_with_other_code_refuses(
    lightstage: Lightstage, ball: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    monkeypatch.setattr(dag_task, "_fit", set())
    monkeypatch.setattr(dag_task, "stage_key", lambda *_: "of older code")
    done = lightstage("run", "--session", "ball", "--set", "normals.method=ratio")
    assert done.code == 1
    assert "this process has other code or libraries for the stage normals than the command had" in done.err


def test_an_asked_node_is_computed_by_name_and_looked_after_from_then_on(
    lightstage: Lightstage, ball: Path
) -> None:
    assert "relief" not in lightstage("run", "--session", "ball", "--json").json["nodes"]
    assert "relief" not in lightstage("status", "--session", "ball", "--json").json["sessions"]["ball"]
    done = lightstage("run", "reflectance", "--session", "ball", "--json").json["nodes"]
    assert {"relief", "reflectance"} <= set(done)
    # no camera, no lights: the inputs that a surface would give are not there, and the stage does without
    opened = xarray.open_zarr(done["reflectance"]["path"], chunks=None)
    assert (opened.attrs["shading"], opened.attrs["scale"]) == ("smooth", "relative")
    assert (
        lightstage("status", "--session", "ball", "--json").json["sessions"]["ball"]["relief"]["status"] == "fresh"
    )
    assert "fresh" in lightstage("why", "reflectance", "--session", "ball").out
    assert "reflectance: albedo in every band" in lightstage("graph").out
