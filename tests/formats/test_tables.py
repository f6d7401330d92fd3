"""Tables as bytes, and read back."""

import csv
import io

import pytest

from lightstage.formats.tables import csv_of_records, csv_of_rows


def test_by_hand() -> None:
    assert csv_of_rows(["a", "b"], [[1, "x, y"], ["", None]]) == b'a,b\n1,"x, y"\n,\n'
    records = [{"name": "é", "value": 1 / 3}, {"name": 'say "so"', "value": 2}]
    assert csv_of_records(("name", "value"), records) == 'name,value\né,0.333333\n"say ""so""",2\n'.encode()


def test_read_back() -> None:
    rows = [["line\nbreak", "1,5"], ["", "tab\t"]]
    back = list(csv.reader(io.StringIO(csv_of_rows(["p", "q"], rows).decode())))
    assert back == [["p", "q"], *rows]


def test_what_is_no_column_is_refused() -> None:
    with pytest.raises(ValueError, match="other"):
        csv_of_records(("name",), [{"name": "a", "other": 1}])
