"""Does a table keep what it is given, and print only what was measured?"""

import csv
import io
import json

import pytest
import rich.console

from torchprt.errors import InputError
from torchprt.measure import Row, Table, Timing


@pytest.fixture
def table():
    table = Table("Compression")
    table.add("exact", error=0.0, seconds=Timing(2.5e-3, 0.04, 2.4e-3, 9), bytes=5_000_000)
    table.add("clusters", error=0.0123456789, seconds=5e-7, bytes=1000, extra={"K": 64})
    table.add("unmeasured")
    return table


def printed(table):
    file = io.StringIO()
    rich.console.Console(width=120, file=file).print(table)
    return file.getvalue()


def test_refuses_a_name_twice(table):
    with pytest.raises(InputError, match="table 'Compression' already has a row 'exact'"):
        table.add("exact")


def test_refuses_a_folder_that_does_not_exist(table, tmp_path):
    for write in (table.to_csv, table.to_json, table.to_markdown):
        with pytest.raises(InputError, match="cannot be written"):
            write(tmp_path / "none" / "a.csv")


def test_an_empty_table_is_a_table(tmp_path):
    table = Table("Nothing")
    table.to_csv(tmp_path / "a.csv")
    table.to_json(tmp_path / "a.json")
    assert (tmp_path / "a.csv").read_text().split() == ["name"]
    assert json.loads((tmp_path / "a.json").read_text()) == {"title": "Nothing", "rows": []}
    assert "Nothing" in printed(table)


def test_add_returns_the_row(table):
    assert table.add("more", error=0.5) == Row("more", error=0.5)
    assert [row.name for row in table.rows] == ["exact", "clusters", "unmeasured", "more"]


def test_prints_units_and_spread(table):
    text = printed(table)
    for part in ("Compression", "2.5 ms ± 4 %", "500 ns", "4.768 MB", "1000 B", "0.0123", "64"):
        assert part in text
    assert "None" not in text


def test_csv_keeps_full_precision_and_leaves_gaps(table, tmp_path):
    table.to_csv(tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["name", "error", "seconds", "spread", "bytes", "K"]
    assert float(rows[1]["error"]) == 0.0123456789
    assert float(rows[0]["spread"]) == 0.04
    assert (rows[0]["K"], rows[1]["K"], rows[2]["error"]) == ("", "64", "")


def test_json_keeps_what_was_measured_alone(table, tmp_path):
    table.to_json(tmp_path / "a.json")
    rows = json.loads((tmp_path / "a.json").read_text())["rows"]
    assert rows[1] == {"name": "clusters", "error": 0.0123456789, "seconds": 5e-7, "bytes": 1000, "K": 64}
    assert rows[2] == {"name": "unmeasured"}


def test_a_column_without_values_is_not_shown():
    table = Table("Errors")
    table.add("a", error=0.1)
    text = printed(table)
    assert "error" in text
    assert "seconds" not in text
    assert "bytes" not in text


def test_markdown_is_what_is_printed_and_a_stroke_stays_in_its_cell(table, tmp_path):
    table.add("a|b", error=0.5)
    table.to_markdown(tmp_path / "a.md")
    title, empty, *lines = (tmp_path / "a.md").read_text().splitlines()
    assert (title, empty) == ("Compression", "")
    assert lines[0] == "| name | error | seconds | bytes | K |"
    assert lines[1] == "| --- | ---: | ---: | ---: | ---: |"
    assert lines[2] == "| exact | 0 | 2.5 ms ± 4 % | 4.768 MB |  |"
    assert lines[-1] == "| a\\|b | 0.5 |  |  |  |"
