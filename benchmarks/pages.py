"""Tables in the pages of docs/: each stands between two comments that bear its name."""

from collections.abc import Sequence
from pathlib import Path


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
