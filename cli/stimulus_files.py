"""The folder of a stimulus set: pictures with their colour said, tables for whoever shows them, a page that runs.

<subject>_<kind>.png        8 bits, sRGB (chunk sRGB), or linear (chunk gAMA 1)
16bit/<subject>_<kind>.png  16 bits, linear (chunk gAMA 1)
stimuli.csv                 what is in each picture
conditions.csv              for PsychoPy (`data.importConditions`)
stimuli.js                  the same as jsPsych timeline variables, for experiment.html
experiment.html             shows them one by one and asks for a key
points.yaml                 where the eyes are in the sessions' pictures, to be changed and given with --points
recipe.json                 what the set was made from
"""

import csv
import hashlib
import io
import json
import math
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.formats.png import encode_png
from lightstage.store.digest import SHORT, digest_value
from lightstage.store.errors import RequestError, WorkError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

COLUMNS = (
    "subject", "kind", "file", "file_16bit", "lights", "mean", "contrast", "rms", "mean_linear", "contrast_linear",
    "clipped", "filled", "width_px", "height_px", "width_deg", "height_deg", "distance_cm", "pixels_per_cm",
    "encoding", "digest", "recipe",
)  # fmt: skip
JSPSYCH = ("jspsych@8.3.0", "@jspsych/plugin-image-keyboard-response@2.2.0")
"""What experiment.html asks for."""


@dataclass(frozen=True)
class Screen:
    """Where the pictures will be shown."""

    distance_cm: float
    pixels_per_cm: float

    def degrees(self, pixels: int) -> float:
        """Visual angle of so many pixels about the middle of the screen."""
        return math.degrees(2 * math.atan(pixels / self.pixels_per_cm / 2 / self.distance_cm))


def png(values: "NDArray[np.integer[Any]]", *, srgb: bool) -> bytes:
    """A PNG that says what its numbers mean.

    Args:
        values: (y, x) grey or (y, x, rgb), uint8 or uint16.
        srgb: encoded as sRGB; otherwise linear light.
    """
    return encode_png(values, light="srgb" if srgb else "linear")


def sha256(data: bytes) -> str:
    """Digest of a file as any tool makes it (`sha256sum`)."""
    return hashlib.sha256(data).hexdigest()


def assemble(
    rows: Sequence[Mapping[str, Any]],
    pictures: Mapping[str, bytes],
    recipe: Mapping[str, Any],
    points: str,
    *,
    jspsych: Path | None,
) -> dict[str, bytes]:
    """Every file of the folder, by name.

    Args:
        rows: one a picture, with COLUMNS.
        pictures: bytes by file name.
        recipe: goes into recipe.json.
        points: goes into points.yaml.
        jspsych: a folder with a copy of jsPsych, which goes into the set; without it the page asks the network.

    Raises:
        RequestError: the folder has no jsPsych.
    """
    files: dict[str, bytes] = dict(pictures)
    files["stimuli.csv"] = _table(rows, COLUMNS)
    shown = [_condition(row) for row in rows]
    files["conditions.csv"] = _table(shown, tuple(shown[0]))
    files["stimuli.js"] = f"const stimuli = {json.dumps(shown, indent=1)};\n".encode()
    if jspsych is not None:
        files |= _copied(jspsych)
    files["experiment.html"] = _page(local=jspsych is not None).encode()
    files["points.yaml"] = points.encode()
    files["recipe.json"] = (json.dumps(recipe, indent=1, sort_keys=True) + "\n").encode()
    return files


def manifest(files: Mapping[str, bytes]) -> str:
    """Digest of everything in the folder."""
    return digest_value({name: sha256(data) for name, data in files.items()})[:SHORT]


def write_set(folder: Path, files: Mapping[str, bytes]) -> bool:
    """Write the whole folder, or nothing; False if the same set is there. The folder's parent is made too.

    Raises:
        RequestError: something else is there.
    """
    if folder.exists():
        if _same(folder, files):
            return False
        raise RequestError(f"{folder}: something is there already, and it is not this set; name a new folder")
    part = folder.with_name(f".{folder.name}.part-{os.getpid()}")
    try:
        part.mkdir(parents=True)
        for name, data in files.items():
            path = part / name
            path.parent.mkdir(exist_ok=True, parents=True)
            path.write_bytes(data)
        os.rename(part, folder)
    except OSError as error:
        raise WorkError(f"{folder} cannot be written ({error.strerror or error})") from None
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return True


def _same(folder: Path, files: Mapping[str, bytes]) -> bool:
    return folder.is_dir() and all(
        (folder / name).is_file() and (folder / name).read_bytes() == data for name, data in files.items()
    )


def _table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()})
    return text.getvalue().encode()


def _condition(row: Mapping[str, Any]) -> dict[str, Any]:
    """What an experiment needs of a picture; names are identifiers, because PsychoPy makes variables of them."""
    keep = ("subject", "kind", "file", "width_px", "height_px", "width_deg", "height_deg")
    return {name: round(row[name], 4) if isinstance(row[name], float) else row[name] for name in keep}


_PLUGIN = "plugin-image-keyboard-response"
_LOCAL = {
    "jspsych.css": "node_modules/jspsych/css/jspsych.css",
    "jspsych.js": "node_modules/jspsych/dist/index.browser.min.js",
    f"{_PLUGIN}.js": f"node_modules/@jspsych/{_PLUGIN}/dist/index.browser.min.js",
}
"""What the page needs: the files' names in a release of jsPsych, and where npm puts them."""


def _copied(source: Path) -> dict[str, bytes]:
    for places in (_LOCAL, _LOCAL.values()):
        found = [source / place for place in places]
        if all(path.is_file() for path in found):
            return {f"jspsych/{name}": path.read_bytes() for name, path in zip(_LOCAL, found, strict=True)}
    raise RequestError(
        f"--jspsych {source}: is no copy of jsPsych; expected a folder with {', '.join(_LOCAL)}, or one in which "
        f"`npm install {' '.join(JSPSYCH)}` was run"
    )


def _page(*, local: bool) -> str:
    base = "https://unpkg.com/"
    style, core, plugin = (
        [f"jspsych/{name}" for name in _LOCAL]
        if local
        else [f"{base}{JSPSYCH[0]}/css/jspsych.css", f"{base}{JSPSYCH[0]}", f"{base}{JSPSYCH[1]}"]
    )
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>Stimuli</title>
<link rel="stylesheet" href="{style}">
<script src="{core}"></script>
<script src="{plugin}"></script>
<script src="stimuli.js"></script>
<style>body {{ background: #bbb; }} img {{ image-rendering: pixelated; }}</style>
</head>
<body>
<script>
if (typeof initJsPsych === "undefined") {{
  // without jsPsych (no network, no local copy) the page shows what there is
  const note = document.createElement("p");
  note.textContent = "jsPsych could not be loaded. Run lightstage stimuli with --jspsych DIR for a local copy.";
  document.body.append(note);
  for (const one of stimuli) {{
    const picture = document.createElement("img");
    picture.src = one.file;
    picture.title = one.subject + ", " + one.kind;
    document.body.append(picture);
  }}
}} else {{
  const jsPsych = initJsPsych({{ on_finish: () => jsPsych.data.displayData("csv") }});
  const trial = {{
    type: jsPsychImageKeyboardResponse,
    stimulus: jsPsych.timelineVariable("file"),
    stimulus_width: jsPsych.timelineVariable("width_px"),
    render_on_canvas: false,
    choices: ["f", "j"],
    prompt: "<p>f: seen before&emsp;j: new</p>",
    data: {{ subject: jsPsych.timelineVariable("subject"), kind: jsPsych.timelineVariable("kind") }},
  }};
  const whole = [{{ timeline: [trial], timeline_variables: stimuli, randomize_order: true }}];
  // experiment.html?simulate answers by itself: a check that every picture loads and the data come out
  if (new URLSearchParams(location.search).has("simulate")) jsPsych.simulate(whole, "visual");
  else jsPsych.run(whole);
}}
</script>
</body>
</html>
"""
