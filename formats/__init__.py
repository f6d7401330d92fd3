"""Files of other programs, one module a kind. Knows no store, no graph and no stage.

errors.py       how a file, or the place for one, is refused
whole_file.py   a file that appears under its name when it is whole
whole_set.py    a folder, or a set of files in one, all or nothing, with a record of what is whose
exr.py          OpenEXR with what its numbers are said
png.py          PNG with its colour said in its chunks
environment.py  environment maps, read
meshes.py       PLY, OBJ and GLB, through trimesh
video.py        MP4 and GIF, through ffmpeg
tables.py       CSV
"""
