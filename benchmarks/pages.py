"""Tables in the pages of docs/: each stands between two comments that bear its name."""

import argparse
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from benchmarks.accuracy import DATA, Bench


def write_tables(about: str | None, page: Path, works: Mapping[str, Callable[[Bench], list[str]]]) -> None:
    """The main function of a benchmark on the shared data: measure every table, or the one after --only.

    Args:
        about: for --help.
        page: where the tables stand.
        works: by name, what makes a table's lines with a store of its own.
    """
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--only", choices=works, help="measure and write this table alone")
    only = parser.parse_args().only
    if not DATA.is_dir():
        raise SystemExit(f"{DATA} is not there; these figures need the shared data")
    with tempfile.TemporaryDirectory() as work:
        bench = Bench(Path(work) / "store")
        for name, table in works.items():
            if only in (None, name):
                lines = table(bench)
                print("\n".join(lines), flush=True)
                put(page, name, lines)


def put(page: Path, name: str, lines: Sequence[str]) -> None:
    """Replace the table `name` of a page: what is between `<!-- name -->` and `<!-- end of name -->`.

    Raises:
        SystemExit: the page has no such place.
    """
    text = page.read_text(encoding="utf-8")
    opening, closing = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
    if opening not in text or closing not in text:
        raise SystemExit(f"{page} lacks <!-- {name} --> or its end; put both where the table belongs")
    head, _, rest = text.partition(opening)
    table = "\n".join(lines)
    page.write_text(f"{head}{opening}\n{table}\n\n{closing}{rest.partition(closing)[2]}", encoding="utf-8")
