"""The numerics: numpy in and numpy out, by subject.

A kernel knows nothing of Dask, zarr, YAML or the graph; it imports nothing of ours but kernels and facts of the rig
(`hw.illuminations`, `hw.geodesic`, `hw.color_checker`), and refuses with a `KernelError`. What these folders'
`__init__` files say is said to people: they hold no code.

    pictures/     resampling, noise, blurs, the subject's mask, sets of pictures
    normals/      from gradients or single lights, with the rig's lights modelled, and filtered
    surface/      depth, the camera's rays, shadows, bounced light
    motion/       the flow of a subject under changing light, and frames in between
    appearance/   colour, pigments, layered skin, gloss, relighting
    faces/        faces aligned, mixed and matched
    targets/      what calibration targets tell of the rig
"""
