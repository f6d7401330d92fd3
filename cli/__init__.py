"""The `lightstage` command: one file a command family; the only place that joins everything.

    main.py      the parser, the errors and the exit codes
    show.py      what a person sees: tables, progress, warnings
    sessions.py  import, sessions, calibration
    run.py       run, normals
    look.py      status, why, graph, path
    keep.py      verify, gc
    export.py    export
    sheet.py     the contact sheet
    demo.py      demo: the virtual rig as a capture
    material.py  material: maps and a mesh for renderers
    relight.py   relight: the subject under other lights
    pictures.py  EXR and PNG whose colour is said; environment maps
    deliver.py   files for a folder of the user's

Modules are imported when their command is used: a fully cached run must not pay for the others.
"""
