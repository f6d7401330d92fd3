"""Files of other programs, one writer each. Knows no store, no graph and no stage.

whole_file.py   a file that appears under its name when it is whole
exr.py          OpenEXR with what its numbers are said
png.py          PNG with its colour said in its chunks
"""
