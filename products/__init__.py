"""What people take away, made of finished results: pictures, films, meshes, maps, tables, stimulus sets.

A product works on datasets and arrays that were opened for it and on plain facts that it is given. It knows no
store, graph, stage or command; it imports kernels, file formats and facts of the rig, and nothing else of ours.

    errors.py           how a product is refused
    choices.py          what a product lets one choose, light to import
    names.py            the names of delivered files
    progress.py         how a product says how far it is
    tracking.py         which tracking frame it is of

    contact_sheet.py    what a session looks like, on one page
    film.py             normals in time, relit, and how fast they change; film_page.py draws a frame
    planes.py           a result's arrays as pictures, for tools that do not read zarr
    mesh.py             height maps as meshes, with texture and normal map
    material.py         what a renderer needs of a subject: EXR maps and a GLB
    relit.py            a subject under other lights: pictures, table, film; light_setups.py has the lights
    skin.py             pigments and spectra of picked points; skin_pages.py draws them
    stimuli.py          a matched set of faces: framing, morphs, matching; stimulus_folder.py is its files
    face_points.py      where the eyes are
    alignment.py        what alignment did to the pictures of a set; alignment_page.py draws it
    calibration_report.py   the page of `calibrate --report`
    sequence_counts.py  how many images a sequence needs

    figures.py          matplotlib and its fonts, as every product uses them
    counts.py           from numbers to the counts of a picture file
"""
