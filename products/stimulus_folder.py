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

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightstage.formats.tables import csv_of_records
from lightstage.products.errors import ProductError

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


def manifest(files: Mapping[str, bytes]) -> dict[str, str]:
    """The digest of everything in the folder, by name."""
    return {name: sha256(data) for name, data in files.items()}


def sha256(data: bytes) -> str:
    """Digest of a file as any tool makes it (`sha256sum`)."""
    return hashlib.sha256(data).hexdigest()


def assemble(
    rows: Sequence[Mapping[str, Any]],
    pictures: Mapping[str, bytes],
    recipe: Mapping[str, Any],
    points: str,
    *,
    jspsych: Mapping[str, bytes],
) -> dict[str, bytes]:
    """Every file of the folder, by name.

    Args:
        rows: one a picture, with COLUMNS.
        pictures: bytes by file name.
        recipe: goes into recipe.json.
        points: goes into points.yaml.
        jspsych: of `jspsych_files`, goes into the set; without it the page asks the network.
    """
    files: dict[str, bytes] = dict(pictures)
    files["stimuli.csv"] = csv_of_records(COLUMNS, rows)
    shown = [_condition(row) for row in rows]
    files["conditions.csv"] = csv_of_records(tuple(shown[0]), shown)
    files["stimuli.js"] = f"const stimuli = {json.dumps(shown, indent=1)};\n".encode()
    files |= jspsych
    files["experiment.html"] = _page(local=bool(jspsych)).encode()
    files["points.yaml"] = points.encode()
    files["recipe.json"] = (json.dumps(recipe, indent=1, sort_keys=True) + "\n").encode()
    return files


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


def jspsych_files(source: Path) -> dict[str, bytes]:
    """A copy of jsPsych, by the names that it has in a set.

    Raises:
        ProductError: the folder has none.
    """
    for places in (_LOCAL, _LOCAL.values()):
        files = [source / place for place in places]
        if all(path.is_file() for path in files):
            return {f"jspsych/{name}": path.read_bytes() for name, path in zip(_LOCAL, files, strict=True)}
    raise ProductError(
        f"{source}: is no copy of jsPsych; expected a folder with {', '.join(_LOCAL)}, or one in which "
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
