"""The `lightstage` command: one file a command family; reads arguments, calls `api`, prints.

    main.py       the table of commands, the errors and the exit codes
    show.py       what a person sees: tables, progress, warnings
    values.py     numbers and places given as options

    sessions.py   import, sessions, calibration
    run.py        run, normals, performance
    look.py       status, why, graph, path
    keep.py       verify, gc, upgrade
    calibrate.py  calibrate
    sequence.py   sequence: what to show, image by image; times.py has the options of its times
    demo.py       demo: the virtual rig as a capture

    alignment.py  alignment: one set before and after
    export.py     export: pictures, films, meshes
    skin.py       skin: pigment maps and spectra
    shape.py      shape: from a capture to a mesh
    stimuli.py    stimuli: matched sets, with stimulus_options.py
    material.py   material: maps and a mesh for renderers
    relight.py    relight: the subject under other lights

A module is imported when its command is used: a fully cached run must not pay for the others.
"""
