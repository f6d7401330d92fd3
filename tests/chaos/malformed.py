"""Files, names and options that cannot be right: generated, from a seed, out of ones that are.

YAML that is cut, doubled, nested, enormous or full of numbers that no field expects; pictures that are cut,
flipped, declared larger than they are, or no files at all; items that no rig can have; names and options of
every odd kind. Each command ends within a minute, with its work done or one sentence, needs less than 2 GB, and
leaves nothing outside the store and the folder that it was given. A picture whose format has a checksum is
refused when it was changed, or gives the pixels that it gave before.
"""

import os
import random
import re
import resource
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
import yaml

from tests.chaos.bench import Trial, item, tree
from tests.chaos.outcome import UnclearError, WrongError
from tests.scenes import write_capture

KINDS = (
    "a description",
    "a pipeline",
    "an item's text",
    "an item's numbers",
    "a picture",
    "options",
    "a large pipeline",
)
TRIALS = 119
MEMORY = 2_000_000_000
SCALARS = (
    "1e999", "-1e999", ".nan", ".inf", "-0.0", "1e308", "5e-324", "9" * 5000, "-" + "9" * 5000,
    "0x7fffffffffffffff", "1_000", "true", "null", "~", "''", "'\\0'", '"\\0"', "../../x", "/etc/passwd",
    "/dev/zero", "/dev/stdin", "a/../b", ".", "..", "[[", "]", "{", "[" * 100_000, "{a: " * 900, "- " * 5000,
    "&a [*a]", "*nobody", "!!python/name:os.system", "!!binary x", "!x y", "'" + "x" * 100_000 + "'",
    "2024-13-45", "2010-03-12T14:05:00", "{}", "[]", "[1, 2, 3]", "1", "-1", "0", "0.5", "{frame:0999999999d}",
    "'{frame:0999999999d}.png'", "'{frame!r:>99999999}.png'", "'{0}{1}.png'", "'{frame.__class__}.png'",
    "ä ö \U0001d518", "\u202e", "'\ud7ff'", "'{illumination}{illumination:>1000000000}.png'", "? x", "<<: {a: 1}",
    "|", ">", "\t",
)  # fmt: skip
NAMES = (
    "dark",
    "flat",
    "str",
    "int",
    "[",
    "]",
    "item",
    "stages",
    "files",
    "target",
    "x" * 5000,
    "ü",
    "",
    "0",
    "null",
)
WORDS = (
    "", " ", "-", "--", "-x", "--no-such", "\0", "a\0b", "x" * 5000, "../x", "/", ".", "..", "ü", "\udcff", "~",
    "~nobody/x", "0", "-1", "1e999", "99999999999999999999", "nan", "0:0", "5:1", "0:99999999999999999999",
    "\u0661:\u0662", "::", "normals.method=", "normals.method=nothing", "normals=", "=", "a.b.c=d",
    "normals.method=[", "x.y=" + "[" * 5000,
    "homography=", "homography=/dev/null", "dark=.", "capture", "current",
    "normals",
    "ball", "png8", "npy", "exr", "glb", "gif", "/dev/null", "/dev/full/x", "*", "%s", "{}",
)  # fmt: skip
OPTIONS = {
    "run": ("--session", "--set", "--frames", "--pipeline", "--calibration", "--workers"),
    "export": ("--session", "--to", "--format", "--convention", "--fps", "--every", "--normal-map"),
    "import": ("--session",),
    "calibration use": ("--session",),
    "calibration show": (),
    "sessions show": (),
    "sessions remove": (),
    "status": ("--session", "--set", "--pipeline"),
    "why": ("--session", "--set", "--pipeline"),
    "path": ("--session",),
    "graph": ("--pipeline",),
    "verify": (),
    "gc": ("--grace",),
    "calibrate": ("--from",),
    "sequence": (),
    "relight": ("--session", "--to"),
}


def kind(seed: int) -> str:
    """The row of the table."""
    return KINDS[seed % len(KINDS)]


def trial(made: Trial) -> None:
    """One malformation."""
    dice = random.Random(f"malformed {made.seed}")
    made.take_store()
    for name in ("home", "cwd", "tmp"):
        (made.room / name).mkdir()
    before = _outside(made)
    {
        "a description": _description,
        "a pipeline": _pipeline,
        "an item's text": _item_text,
        "an item's numbers": _item_numbers,
        "a picture": _picture,
        "options": _options,
        "a large pipeline": _large_pipeline,
    }[kind(made.seed)](made, dice)
    new = sorted(_outside(made) - before)
    if new:
        raise WrongError(f"{kind(made.seed)}: {new[0]} was made outside the store and the target")


def _outside(made: Trial) -> set[str]:
    """What lies in home, working folder and temporary folder; compiled code may."""
    return {
        f"{name}/{path}" for name in ("home", "cwd", "tmp") for path in tree(made.room / name) if ".nb" not in path
    }


def _try(made: Trial, *words: str | Path, **more: Any) -> int:
    """A command that may refuse; returns its exit code."""
    answer = made.command(*words, limits={resource.RLIMIT_AS: 8 * MEMORY}, **more).clear()
    if answer.peak_bytes > MEMORY:
        raise UnclearError(f"{answer}: {answer.peak_bytes / 1e9:.1f} GB of memory")
    return answer.code or 0


def mangled(text: str, dice: random.Random) -> bytes:
    """A YAML text that is no longer what it was."""
    lines = text.splitlines()
    for _ in range(dice.choice((1, 1, 1, 2, 5))):
        at = dice.randrange(len(lines))
        line = lines[at]
        way = dice.randrange(9)
        if way <= 3:
            spots = list(re.finditer(r"[^\s:,\[\]{}-][^:,\[\]{}]*(?=$|[,\]}])", line))
            if spots:
                spot = dice.choice(spots)
                lines[at] = line[: spot.start()] + dice.choice(SCALARS) + line[spot.end() :]
        elif way == 4:
            lines[at] = re.sub(r"[\w-]+(?=:)", lambda _: dice.choice(NAMES), line, count=1)
        elif way == 5:
            lines.insert(at, dice.choice((line, f"{dice.choice(NAMES)}: {dice.choice(SCALARS)}")))
        elif way == 6 and len(lines) > 1:
            del lines[at]
        elif way == 7:
            lines[at] = " " * dice.randrange(9) + line
        else:
            lines[at] = dice.choice(SCALARS)
    made = "\n".join(lines).encode("utf-8", "surrogatepass")
    way = dice.randrange(12)
    if way == 0:
        made = _bomb().encode()
    elif way == 1:
        made = bytes(dice.randrange(256) for _ in range(300))
    elif way == 2:
        made = made.decode(errors="replace").encode(dice.choice(("utf-16", "utf-32", "utf-8-sig")))
    elif way == 3:
        made = made[: dice.randrange(len(made))]
    elif way == 4:
        made += b"\n" + b"x" * dice.choice((10**6, 10**8))
    return made


def _bomb() -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)]
    return "\n".join(lines)


def _description(made: Trial, dice: random.Random) -> None:
    folder = made.take_capture()
    file = folder / "capture.yaml"
    text = yaml.safe_dump(
        yaml.safe_load(file.read_text()), sort_keys=False, default_flow_style=dice.choice((None, False))
    )
    _write(file, mangled(text, dice), dice)
    _try(made, "import", folder)
    _try(made, "run", *made.options)


def _write(file: Path, data: bytes, dice: random.Random) -> None:
    """The file, or now and then something that is no file."""
    way = dice.randrange(25)
    file.unlink(missing_ok=True)
    if way == 0:
        os.mkfifo(file)
    elif way == 1:
        file.mkdir()
    elif way == 2:
        file.symlink_to(
            dice.choice(("/dev/zero", "/dev/stdin", "/dev/null", "/dev/full", file.name, "/proc/self/mem"))
        )
    else:
        file.write_bytes(data)


def _pipeline(made: Trial, dice: random.Random) -> None:
    file = made.room / "pipeline.yaml"
    _write(file, mangled(made.bench.pipeline.read_text(), dice), dice)
    _try(made, dice.choice(("run", "status")), "--session", "ball", "--pipeline", file)
    _try(made, "graph", "--pipeline", file)


def _item_text(made: Trial, dice: random.Random) -> None:
    folder = made.take_capture()
    name = dice.choice(("homography", "bands", "dark", "flat"))
    file = folder / "calibration" / f"{name}.yaml"
    _write(file, mangled(yaml.safe_dump(item(name), sort_keys=False), dice), dice)
    _try(made, "import", folder)
    _try(made, "calibration", "use", file, "--session", "ball")
    _try(made, "run", *made.options)


def _item_numbers(made: Trial, dice: random.Random) -> None:
    """Numbers that can be read and cannot be."""
    camera: dict[str, Any] = {
        "item": "camera",
        "size_px": [24, 18],
        "K": [[60, 0, 11.5], [0, 60, 8.5], [0, 0, 1]],
        "distortion": [0, 0, 0, 0, 0],
        "world_to_camera": {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, 890]},
    }
    count = dice.choice((1, 3, 41, 20_000))
    lights: dict[str, Any] = {"item": "lights", "lights": []}
    for i in range(count):
        place = [round(dice.uniform(-800, 800), 3) for _ in range(3)]
        lights["lights"].append({"id": f"L{i}", "position_mm": place, "drive_position": [0.6, 0.0, 0.8]})
    odd = dice.choice((0.0, -1.0, 1e308, -1e308, 1e-308, 5e-324, 1e12, 3.0))
    kind_of = dice.choice(("camera", "lights", "homography", "bands", "dark", "flat"))
    made_item: dict[str, Any] = {"camera": camera, "lights": lights}.get(kind_of) or item(kind_of)
    if kind_of == "camera":
        where = dice.choice(("K", "R", "t_mm", "distortion", "size_px"))
        values = made_item["world_to_camera"] if where in ("R", "t_mm") else made_item
        row = values[where][dice.randrange(3)] if where in ("K", "R") else values[where]
        row[dice.randrange(len(row))] = int(min(odd, 1e12)) if where == "size_px" else odd
    elif kind_of == "lights":
        for light in lights["lights"] if dice.random() < 0.3 else lights["lights"][:1]:
            light[dice.choice(("position_mm", "drive_position"))] = [odd, 0.0, 0.0]
    elif kind_of == "homography":
        made_item["matrix"] = [[float(v) for v in row] for row in made_item["matrix"]]
        made_item["matrix"][dice.randrange(3)][dice.randrange(3)] = odd
    elif kind_of == "bands":
        made_item["bands"][0][dice.choice(("exposure", "transmission", "centre_nm", "width_nm", "source"))] = odd
    else:
        made_item["scale"] = odd
        made_item["hot_px" if kind_of == "dark" else "dead_px"] = {"CAM0": [[dice.choice((0, -1, 10**9)), 0]]}
        if dice.random() < 0.3:
            shape = dice.choice(((18, 24), (1, 1), (18, 25), (0, 0)))
            for camera_name in ("CAM0", "CAM1"):
                pixels = np.full(shape if shape[0] else (2, 2), dice.choice((0, 1023, 65535)), np.uint16)
                cv2.imwrite(str(made.bench.folder / "no") + f"{made.seed}.png", pixels)
                (made.room / f"{kind_of}_{camera_name}.png").write_bytes(
                    Path(f"{made.bench.folder / 'no'}{made.seed}.png").read_bytes()
                )
    for camera_name in ("CAM0", "CAM1"):
        name = f"{kind_of}_{camera_name}.png"
        source = made.bench.items / name
        if source.exists() and not (made.room / name).exists():
            (made.room / name).write_bytes(source.read_bytes())
    file = made.room / f"{kind_of}.yaml"
    file.write_text(yaml.safe_dump(made_item))
    _try(made, "calibration", "use", file, "--session", "ball")
    _try(made, "run", *made.options)
    _try(made, "run", *made.options, "--set", "normals.correct=near")


def _picture(made: Trial, dice: random.Random) -> None:
    folder = made.take_capture()
    form = dice.choice(("png", "png", "tif", "tif deflate"))
    if form != "png":
        shape = (12, 16)
        pictures = {
            (i, 0, "cross"): np.random.default_rng(i).integers(50, 900, shape).astype(np.uint16) for i in range(2)
        }
        folder = write_capture(made.room / "tiffs", pictures, illumination=["C", "X"])
        description = yaml.safe_load((folder / "capture.yaml").read_text())
        description["files"] = description["files"].replace(".png", ".tif")
        (folder / "capture.yaml").write_text(yaml.safe_dump(description))
        for path in sorted(folder.glob("*.png")):
            pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            compression = {"compression": "zlib"} if form == "tif deflate" else {}
            tifffile.imwrite(path.with_suffix(".tif"), pixels, **compression)
            path.unlink()
    paths = sorted([*folder.glob("*.png"), *folder.glob("*.tif")])
    path = dice.choice(paths)
    wanted = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    data = bytearray(path.read_bytes())
    way = dice.choice(("a flip", "a flip", "a flip", "cut", "sizes", "no file", "noise"))
    if way == "a flip":
        data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
    elif way == "cut":
        del data[dice.randrange(len(data)) :]
    elif way == "noise":
        at = dice.randrange(len(data))
        data[at : at + 20] = bytes(dice.randrange(256) for _ in range(20))
    elif way == "sizes" and path.suffix == ".png":
        import zlib

        size = dice.choice((0, 1, 16000, 60000, 2**31 - 1, 2**32 - 1))
        data[16:24] = size.to_bytes(4, "big") * 2
        data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    elif way == "sizes":
        pixels = np.zeros((12, 16), np.uint16)
        tifffile.imwrite(path, pixels, compression="zlib")
        data = bytearray(path.read_bytes())
        with tifffile.TiffFile(path) as file:
            tags = file.pages[0].tags  # type: ignore[union-attr]
            tag = tags[
                dice.choice(("ImageWidth", "ImageLength", "StripOffsets", "StripByteCounts", "RowsPerStrip"))
            ]
            at, size = tag.valueoffset, 2 if tag.dtype == 3 else 4
        number = dice.choice((0, 1, 16000, 60000, 65535))
        data[at : at + size] = number.to_bytes(size, "little")
    if way == "no file":
        path.unlink()
        other = dice.randrange(4)
        if other == 0:
            os.mkfifo(path)
        elif other == 1:
            path.mkdir()
        else:
            path.symlink_to(dice.choice(("/dev/zero", "/dev/stdin", "/dev/null", path.name, "/dev/full")))
    else:
        path.write_bytes(data)
    code = _try(made, "import", folder, "--session", "odd")
    if code == 0 and way == "a flip" and form != "tif":
        answer = made.command(
            "export", "capture", "--session", "odd", "--to", made.room / "out", "--format", "npy", "--json"
        )
        found = [np.load(file) for file in answer.done().json["files"]]
        if not any(np.array_equal(pixels, wanted) for pixels in found):
            raise WrongError(f"{form} with {way}: it was imported with other pixels, exit 0")


def _options(made: Trial, dice: random.Random) -> None:
    for _ in range(6):
        command = dice.choice(sorted(OPTIONS))
        words: list[str] = command.split()
        known = {"--session": "ball", "--pipeline": str(made.bench.pipeline), "--to": str(made.room / "target")}
        known |= {"--format": "npy", "--from": str(made.bench.capture)}
        for option in OPTIONS[command]:
            chance = dice.random()
            if chance < 0.35 or (option == "--workers" and chance < 0.9):
                if option in known and dice.random() < 0.8:
                    words += [option, known[option]]
            elif chance < 0.6 and option in known:
                words += [option, known[option]]
            elif chance < 0.8:
                words += [option, dice.choice(WORDS)]
        if command not in ("verify", "gc", "status", "graph"):
            words.insert(len(command.split()), dice.choice((*WORDS, "normals", "ball", str(made.bench.capture))))
        if dice.random() < 0.2:
            words.append(dice.choice(WORDS))
        if dice.random() < 0.15:
            odd = dice.choice(("", "/dev/null", "/proc/1", str(made.room / "loop"), "x" * 5000, "a\0b", "s3://x"))
            if not (made.room / "loop").is_symlink():
                (made.room / "loop").symlink_to("loop")
            _try(made, *words, store=Path(odd) if odd and "\0" not in odd else _Plain(odd))
        else:
            _try(made, *words)


class _Plain:
    """A store that is no path."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __str__(self) -> str:
        return self._text


def _large_pipeline(made: Trial, dice: random.Random) -> None:
    count = dice.choice((300, 1000, 5000, 10_000))
    way = dice.choice(("a chain in reverse", "a circle", "flat", "one name"))
    lines = ["stages:", "  capture: {uses: capture}", "  register: {uses: register, from: capture}"]
    if way == "flat":
        lines += [f"  n{i}: {{uses: split, from: register}}" for i in range(min(count, 1000))]
    elif way == "one name":
        lines += [f"  {'n' * count}: {{uses: split, from: register}}"]
    else:
        first = "register" if way != "a circle" else f"n{count - 1}"
        chain = [f"  n{i}: {{uses: split, from: {f'n{i - 1}' if i else first}}}" for i in range(count)]
        lines += reversed(chain)
    file = made.room / "pipeline.yaml"
    file.write_text("\n".join(lines))
    _try(made, "status", "--session", "ball", "--pipeline", file)
    if way == "flat" and count <= 300:
        _try(made, "run", "--session", "ball", "--pipeline", file)
