"""What is on disk: sessions, calibration items, results, blocks and their traces. Knows no graph.

errors.py       the two kinds of failure, each with its exit code
digest.py       content digests of values and of bytes
sealed.py       small JSON files that tell when they have changed
marker.py       store.json: what the folder is, in which format, and which store
files.py        atomic writes, links or copies, what a disk refuses, sizes for humans
intake.py       files that a user names: regular, of a sane size, read whole
picture.py      integer pictures: PNG and TIFF, whole or refused
document.py     YAML with line and column, checked against a model
root.py         the folder itself, and the one object that joins the rest
chunks.py       stored chunks, addressed by content
records.py      what was computed from what: block, node and run records
notes.py        beside each group, what its files should be
checked.py      a group read with every byte checked
unshared.py     a group written where nobody else writes
grid.py         the zarr groups that anyone can open with xarray
names.py        what sessions and nodes may be called
capture.py      the capture folder, as it comes off a rig
importer.py     a capture folder brought into the store
sessions.py     imported captures, and how they are changed
items.py        calibration items, as the store keeps them
calibration.py  what the file of an item says, kind by kind
results.py      the result folders
verify.py       every byte read, what can be mended mended, the rest named
gc.py           what nothing refers to is freed
upgrade.py      an older store carried over
"""
