"""The Python API, and the one place that joins engine, stages, store and products. The command line calls it.

    stores.py         an opened store: sessions, items, answers to requests
    sessions.py       one session of it: run, look, take out
    requests.py       a request made of Python values or of a command's texts
    answers.py        requests answered: computed or remembered, foretold, explained
    groups.py         which zarr group a node's pictures lie in
    pipelines.py      a pipeline file, read and checked
    items.py          calibration items, and who uses them
    calibration.py    measuring an item from pictures of a target
    exports.py        results as files of other programs
    pictures.py       pictures that the store keeps beside its results
    pages.py          pages that show a session, beside them or where a user wants them
    subjects.py       results read for the products that are made of them
    deliveries.py     materials and relit pictures, into a folder of the user's
    stimulus_sets.py  matched sets of faces; face_points.py reads where their eyes are
    errors.py         what can fail, and the exit codes
    refusals.py       what products, formats and kernels refuse, as a wrong request
    sequences.py      capture sequences: planned, judged, written
    virtual_rig.py    captures of heads and targets that never were

What it gives back are frozen records, and results as `xarray.Dataset`. Nothing heavy is imported before it is
needed: a request that was answered before is answered without numpy.
"""
