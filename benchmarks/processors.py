"""How far results lie apart, of a still head and of a performance, under settings that leave instructions of the processor out.

Prints the table of docs/accuracy.md, "On other processors". What is compared, and by what measure: tests/processors.py.
"""

import argparse
import itertools
import sys
import tempfile
from pathlib import Path

from tests.processors import DEGREES, IN_STEPS, RELATIVE, SETTINGS, apart, results


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", default="203x154", help="of the virtual rig's pictures (default: 203x154)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        found = results(Path(work), options.size)
    print("| subject | setting | normals, degrees | all else, relative | another step | where most |")
    print("|---|---|---|---|---|---|")
    for session, setting in itertools.product(found, SETTINGS):
        if setting == "as it is":
            continue
        whole, other = found[session]["as it is"], found[session][setting]
        degrees = relative = share = 0.0
        where = "-"
        for name, one in whole.items():
            far, off = apart(name, one, other[name])
            worst = float(off.max(initial=0.0))
            if name.endswith("/unrounded normal"):
                degrees = max(degrees, worst * DEGREES)
            elif name in IN_STEPS or one.dtype.kind in "biu":
                share = max(share, float(far.mean()))
            elif worst * RELATIVE > relative:
                relative, where = worst * RELATIVE, name
        print(f"| {session} | {setting} | {degrees:.0e} | {relative:.0e} | {share:.4%} | {where} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
