"""CSV as every table of ours is written: a line feed at the end of a row, UTF-8, a point in numbers."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def csv_of_rows(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> bytes:
    """A table of rows as they are, below their head."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(head)
    table.writerows(rows)
    return text.getvalue().encode()


def csv_of_records(columns: Sequence[str], records: Iterable[Mapping[str, Any]]) -> bytes:
    """A table of records by column, floats to six digits.

    Raises:
        ValueError: a record has what is no column.
    """
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    for record in records:
        table.writerow({name: f"{v:.6g}" if isinstance(v, float) else v for name, v in record.items()})
    return text.getvalue().encode()
