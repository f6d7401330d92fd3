"""The stages: one file each, and the table that names them.

A stage is a pure kernel on numpy arrays plus what it reads and its parameters (`dag.stage.Stage`). Adding one
is adding a file, a line here, and its name in `pipeline.yaml`. Modules that are not in the table are kernels
that a stage calls; they count in its key.

    joint_flow.py            the motion of a subject under changing light, all pictures of a window at once
    band_alignment.py        the bands of a capture, brought to one of them
    blurs.py                 blurs whose every bit is the same on every processor
    block_grid.py            fields on a block grid that bend little, its linear algebra
    picture_flow.py          the same by flows between two pictures at a time, for reference
    flow_warp.py             what flows do to pictures: warping, and the inverse of a flow
    in_between.py            normals between tracking frames
    picture_sets.py          which pictures belong together: sets and windows
    spherical_gradients.py   fused per-pixel kernels of the gradient methods
    one_light.py             photometric stereo from one light at a time
    band_fusion.py           one picture from all bands, weighted by noise
    resampling.py            dark, flat, and one cubic resampling
    rig_normals.py           normals with a model of the rig's lights, put together from the next four
    openness.py              how much light a point sees, by the length of its light's mean direction
    loose_parts.py           parts that normals hold to each other only loosely, placed by their light
    near_light.py            how a near-light rig shades a point, and the normal that this tells
    self_consistent.py       depth, shadows and bounced light, found together with the normals
    integration.py           depth from normals
    visibility.py            which lights each point sees
    interreflection.py       bounced light, from six bands or from tiles
    normal_filter.py         non-local means on normals
    subject_mask.py          where the subject is
    colour.py                from narrow bands to colour
    shading.py               a surface under lights that somebody chooses, with cast shadows
    absorption.py            how strongly melanin and blood absorb, over the pass bands of filters
    skin_layers.py           what layered skin reflects, and whether a spectrum is like it
    microfacets.py           how a rough surface reflects, and what a rig's lights show of it
    relighting.py            a found surface under other lights
    face_frame.py            faces brought to one place, under one oval
    face_flow.py             which place of one face is which of another, and what lies between the two
    matching.py              equal mean, contrast, histogram and spectrum, in pictures as they are stored
    pinhole.py               the reference camera: rays, points, smaller pictures
"""

from collections.abc import Mapping

from lightstage.stages.calibration import MEASURED, STEPS

TABLE: Mapping[str, str] = {
    "capture": "lightstage.stages.capture",
    "register": "lightstage.stages.register",
    "split": "lightstage.stages.split",
    "stack": "lightstage.stages.stack",
    "align": "lightstage.stages.align",
    "normals": "lightstage.stages.normals",
    "upsample": "lightstage.stages.upsample",
    "reflectance": "lightstage.stages.reflectance",
    "shape": "lightstage.stages.shape",
    "stimulus": "lightstage.stages.stimulus",
    "chromophores": "lightstage.stages.chromophores",
    "gloss": "lightstage.stages.gloss",
    **{name: f"lightstage.stages.calibration.{name}" for name in (*STEPS, *MEASURED)},
}
