"""Reflectance of the 24 patches of a ColorChecker at the thesis' six bands, from its dark skin patch by rows.

Facts from N. Ohta, The Basis of Color Reproduction Engineering (1997), 380 to 780 nm in steps of 5, interpolated
between its samples and rounded to 0.001. Charts differ by a few per cent, and white falls steeply below 420 nm.
Pure Python, for whoever names patches or bands.
"""

BANDS_NM = (407, 434, 445, 497, 576, 655)
ROWS, COLUMNS = 4, 6
NAMES = (
    "dark skin", "light skin", "blue sky", "foliage", "blue flower", "bluish green",
    "orange", "purplish blue", "moderate red", "purple", "yellow green", "orange yellow",
    "blue", "green", "red", "yellow", "magenta", "cyan",
    "white", "neutral 8", "neutral 6.5", "neutral 5", "neutral 3.5", "black",
)  # fmt: skip
_PER_MILLE = """
 68  57  54  60 109 196   194 207 217 298 332 597   308 337 334 265 166 115    49  53  56  74 124  95
398 447 440 348 200 351   292 342 363 579 364 209    54  52  52  60 425 602   278 358 383 215  83 118
145 132 131 104 132 608   194 181 156  69  53 182    61  66  71 240 468 320    65  65  66 118 573 675
164 261 316 134  41  43    58  63  67 166 213  76    51  49  49  44  65 694    53  53  54 272 700 779
330 341 313 168 127 756   227 293 334 441 103  75   590 881 885 888 888 889   487 587 588 580 587 577
333 360 362 356 361 350   195 204 205 202 204 198    93  95  95  92  93  89    35  36  35  34  33  33
"""
_VALUES = [int(value) / 1000 for value in _PER_MILLE.split()]
REFLECTANCE = tuple(tuple(_VALUES[i : i + len(BANDS_NM)]) for i in range(0, len(_VALUES), len(BANDS_NM)))
"""(patch, band)."""
