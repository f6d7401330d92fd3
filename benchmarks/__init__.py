"""Every speed and accuracy figure in README and docs, runnable as `python -m benchmarks.NAME`.

    kernels       the per-pixel kernels against numpy, OpenCV and a copy of the same bytes
    store         what the care of the store costs: a cached run, verify
    pipeline      whole runs: end to end, cached, memory, processes
    start_up      what commands that compute nothing cost beside `import numpy`
    growth        what a run costs against the number of its pictures
    peers         the cached run and small changes beside doit, Snakemake, DVC and redun
    contents      content digests of every array, before and after a change
    processors    results under other processors' instructions
    accuracy      degrees against truth; writes docs/accuracy.md and its figures
    calibration   items against truth
    near_light    normals with near lights, shadows and bounced light
    alignment     engines on synthetic motion, and the bands of a capture
    moving        rendered heads that move, with sequences side by side
    reflectance   albedo against truth
    skin          pigments against truth and measured skin
    shape         height maps and meshes
    relighting    gloss, and a found surface under other lights
    stimuli       matched sets, eyes and morphs

Those from near_light on write their tables into docs/ (`pages.py`).
"""
